"""No test waits without a bound, and processes are started where their signals are set: read from the tests' text."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
STARTS = {"run", "call", "check_call", "check_output"}
WAITS = {"acquire", "communicate", "get", "join", "result", "wait"}


def unbounded(text: str, *, may_start: bool = False) -> list[str]:
    """Calls that may last for ever, and `Popen` where it is not allowed, by line."""
    found = []
    for node in ast.walk(ast.parse(text)):
        if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
            continue
        name, given = ast.unparse(node.func), {each.arg for each in node.keywords}
        started = name in {f"subprocess.{start}" for start in STARTS} and "timeout" not in given
        waits = node.func.attr in WAITS and not node.args and "timeout" not in given
        if started or waits or (name == "subprocess.Popen" and not may_start):
            found.append(f"{node.lineno}: {name}")
    return found


def test_every_wait_has_a_bound():
    found = {
        str(path.relative_to(TESTS)): calls
        for path in sorted(TESTS.rglob("*.py"))
        if (calls := unbounded(path.read_text(), may_start=path.name == "children.py"))
    }
    assert not found, f"give a timeout, and start processes with children.child: {found}"


@pytest.mark.parametrize(
    "call",
    [
        "subprocess.run(['a'], check=True)",
        "thread.join()",
        "process.communicate(input='a')",
        "queue.get()",
        "process.wait()",
        "subprocess.Popen(['a'])",
    ],
)
def test_a_wait_without_one_is_found(call: str):
    assert unbounded(call) == [f"1: {call.split('(')[0]}"]


def test_a_wait_with_one_is_not():
    bounded = "subprocess.run(['a'], timeout=1); thread.join(60); ', '.join(names); table.get('a'); run('a')"
    assert unbounded(bounded) == []
