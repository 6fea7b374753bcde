"""Small faults put into a source file, and a sample of them; the faults themselves are cosmic-ray's.

A *place* is a number, an operator, a condition and so on in one file; a *mutant* is one change there. Left out are
places whose change no test should see: annotations, what an error or the log says, decorators.
"""

from __future__ import annotations

import ast
import builtins
import hashlib
import itertools
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator

ALIKE = (
    *itertools.permutations(("Add", "Sub", "Mul", "Div"), 2),
    *(("FloorDiv", "Mod"), ("FloorDiv", "Mul"), ("Mod", "FloorDiv"), ("Pow", "Mul")),
    *(("BitOr", "BitAnd"), ("BitAnd", "BitOr"), ("BitXor", "BitOr")),
    *(("Eq", "NotEq"), ("NotEq", "Eq"), ("Is", "IsNot"), ("IsNot", "Is")),
    *itertools.permutations(("Lt", "LtE", "Gt", "GtE"), 2),
)
"""What an operator becomes: another that takes the same operands, so that the line runs and its answer is wrong."""
COMPARISONS = ("Eq", "NotEq", "Is", "IsNot", "Lt", "LtE", "Gt", "GtE")
OPERATORS = (
    *(f"Replace{'Comparison' if old in COMPARISONS else 'Binary'}Operator_{old}_{new}" for old, new in ALIKE),
    *(f"ReplaceUnaryOperator_{change}" for change in ("USub_UAdd", "Delete_USub", "Delete_Not", "Delete_Invert")),
    *("AddNot", "ReplaceTrueWithFalse", "ReplaceFalseWithTrue", "ReplaceAndWithOr", "ReplaceOrWithAnd"),
    *("ReplaceBreakWithContinue", "ReplaceContinueWithBreak", "ExceptionReplacer", "NumberReplacer"),
    "ZeroIterationForLoop",
)
"""Of cosmic-ray's own, those that are drawn from."""
SAYING = re.compile(r"(log|logger|logging|warnings|click)\.\w+|print|.*Error|.*\.say|describe|field|Field")
"""Calls whose arguments are words for people, or a setting's documentation."""


@dataclass(frozen=True)
class Mutant:
    """One change of one file."""

    file: str
    line: int
    function: str
    """Dotted name of what holds the line; empty at the top of the file."""
    before: str
    after: str
    changed: str
    """The whole file with the change."""

    def record(self) -> dict[str, Any]:
        """For JSON."""
        return {key: value for key, value in asdict(self).items() if key != "changed"}


@dataclass(frozen=True)
class Place:
    """Where a file can be changed, and by which of the possible changes of which operators."""

    file: str
    line: int
    function: str
    key: str
    """A hash of the place's text: not of the file's name, nor of the line's number."""
    ways: tuple[tuple[str, int], ...]

    def mutant(self, root: Path) -> Mutant:
        """One of its changes, chosen by the key."""
        name, occurrence = self.ways[int(self.key, 16) % len(self.ways)]
        source = (root / self.file).read_text()
        changed = mutate_code(source, get_operator(f"core/{name}")(), occurrence)
        assert changed is not None, self
        return Mutant(self.file, self.line, self.function, *_difference(source, changed), changed)


def sample(root: Path, files: Sequence[str], count: int, seed: int) -> list[Mutant]:
    """`count` mutants of those files, or as many as there are, never two of one place.

    Drawn by hashes of their text, so that a line which is moved, or a file which is renamed, keeps its mutants.
    """
    places = [place for file in files for place in _places(root, file, seed)]
    return [place.mutant(root) for place in sorted(places, key=lambda place: place.key)[:count]]


def _places(root: Path, file: str, seed: int) -> Iterator[Place]:
    source = (root / file).read_text()
    lines, tree, nodes = source.splitlines(), ast.parse(source), list(ast_nodes(get_ast(source)))
    silent, names = list(_silent(tree)), _names(tree)
    ways: dict[tuple[int, int], list[tuple[str, int]]] = {}
    for name in OPERATORS:
        operator = get_operator(f"core/{name}")()
        spans = (span for node in nodes for span in operator.mutation_positions(node))
        for occurrence, (begin, end) in enumerate(spans):
            text = lines[begin[0] - 1][begin[1] :]
            dotted = name == "ExceptionReplacer" and "." in text[: end[1] - begin[1]]  # it knows plain names only
            if dotted or text.startswith("*,"):
                continue
            if not any(first <= begin < last for first, last in silent):
                ways.setdefault(begin, []).append((name, occurrence))
    seen: Counter[str] = Counter()
    for line, column in sorted(ways):
        indent = len(lines[line - 1]) - len(lines[line - 1].lstrip())
        text = f"{seed} {names.get(line, '')} {lines[line - 1].strip()} {column - indent}"
        seen[text] += 1
        key = hashlib.sha256(f"{text} {seen[text]}".encode()).hexdigest()
        yield Place(file, line, names.get(line, ""), key, tuple(ways[line, column]))


def _difference(old: str, new: str) -> tuple[str, str]:
    """The lines that differ, in one."""
    both = itertools.zip_longest(old.splitlines(), new.splitlines(), fillvalue="")
    pairs = [(a.strip(), b.strip()) for a, b in both if a != b]
    return " ".join(a for a, _ in pairs), " ".join(b for _, b in pairs)


def _names(tree: ast.Module) -> dict[int, str]:
    """Of each line, the dotted name of the function or class that holds it."""
    names: dict[int, str] = {}

    def visit(node: ast.AST, prefix: str) -> None:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.FunctionDef | ast.ClassDef | ast.AsyncFunctionDef):
                name = f"{prefix}.{child.name}".strip(".")
                names.update(dict.fromkeys(range(child.lineno, (child.end_lineno or child.lineno) + 1), name))
                visit(child, name)
            else:
                visit(child, prefix)

    visit(tree, "")
    return names


def _silent(tree: ast.Module) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """Spans (line, column) of what no test should see."""
    for node in ast.walk(tree):
        parts: list[ast.AST | None] = []
        match node:
            case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.ClassDef():
                parts += node.decorator_list
                parts += [node.returns] if not isinstance(node, ast.ClassDef) else []
            case ast.arg() | ast.AnnAssign():
                parts.append(node.annotation)
            case ast.Raise() | ast.BinOp(op=ast.Div(), right=ast.JoinedStr() | ast.Constant(value=str())):
                parts.append(node)  # an error, or a path
            case ast.keyword(arg="strict"):
                parts.append(node)
            case ast.Assert():
                parts.append(node.msg)
            case ast.Call() if SAYING.fullmatch(ast.unparse(node.func)):
                parts.append(node)
            case ast.If() if ast.unparse(node.test) in ("TYPE_CHECKING", "__name__ == '__main__'"):
                parts.append(node)
            case ast.BinOp(op=ast.BitOr()) if _is_type(node):
                parts.append(node)
        for part in parts:
            if part is not None:
                yield _span(part)


def _is_type(union: ast.BinOp) -> bool:
    """Whether a union is of types: by their capitals, builtin names and None."""
    names = [node.id if isinstance(node, ast.Name) else node.attr for node in _leaves(union)]
    return all(name[:1].isupper() or isinstance(getattr(builtins, name, None), type) for name in names)


def _leaves(union: ast.expr) -> Iterator[ast.Name | ast.Attribute]:
    match union:
        case ast.BinOp(op=ast.BitOr()):
            yield from _leaves(union.left)
            yield from _leaves(union.right)
        case ast.Subscript():
            yield from _leaves(union.value)
        case ast.Name() | ast.Attribute():
            yield union
        case ast.Constant(value=None):
            pass
        case _:
            yield ast.Name("value")  # of something that is no type


def _span(node: Any) -> tuple[tuple[int, int], tuple[int, int]]:
    return (node.lineno, node.col_offset), (node.end_lineno, node.end_col_offset)
