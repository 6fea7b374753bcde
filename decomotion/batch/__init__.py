"""Many clips: each fitted, exported and asked, whatever happens to one of them. No torch in this process."""
