"""Links: where points of every frame lie in all others, from flow at a few gaps and from matches by appearance."""
