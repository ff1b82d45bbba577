"""Print figures of the project's order and words beside those of commit 15ec78a (`make figures`).

The figures are to see by: a name is good when a reader knows without its file what it does.
"""

import ast
import re
import sys
from functools import cache
from pathlib import Path
from statistics import median

from local_names import measure_product

ROOT = Path(__file__).parents[1]
PACKAGES = ("orchestrator", "adapters", "sim")
MAKES = ("smc4000", "smc2000", "shrc203", "ppsmc", "smc30", "cia402")
MAX_CLASS_LINES = 250
MAX_COMPLEXITY = 12

BEFORE: dict[str, str] = {
    "functions with a one-word name": "69 %",
    "classes with a one-word name": "66 %",
    "median length of a function's name": "7",
    "README, lines": "427",
    "most files in one folder": "66",
    "circles of imports": "5",
    "longest circle of imports, files": "24",
    "exceptions outside the tree": "42",
    "classes over 250 lines": "32",
    "functions over complexity 12": "28",
    "asserts for 'connected'": "50",
    "files outside a make's folder that name a make": "25",
    "log calls per 1,000 lines of adapters": "0.9",
    "local names that are no nouns, per 1,000 lines": "26.0",
    "product lines": "76656",
}

Function = ast.FunctionDef | ast.AsyncFunctionDef


def product_files() -> list[Path]:
    """All Python files of the product."""
    return sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


@cache
def parse_file(path: Path) -> ast.Module:
    """The syntax tree of a file; each one is read once."""
    return ast.parse(path.read_text(encoding="utf-8"))


def module_name(path: Path) -> str:
    """The dotted name of a file; of `__init__.py`, that of its package."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def is_one_word(name: str) -> bool:
    """Whether a name has one word: `poll`, `_poll`, `Poll`, but not `poll_all` or `PollAll`."""
    bare = name.strip("_")
    return "_" not in bare and len(re.findall(r"[A-Z][a-z0-9]*|[a-z0-9]+", bare)) <= 1


def complexity(function: Function) -> int:
    """McCabe's complexity: branches plus 1, without those of inner functions; operators of conditions do not count."""
    count, todo = 1, list(ast.iter_child_nodes(function))
    while todo:
        node = todo.pop()
        if isinstance(node, Function):
            continue
        count += isinstance(node, ast.If | ast.For | ast.AsyncFor | ast.While | ast.ExceptHandler | ast.comprehension)
        count += isinstance(node, ast.match_case)
        todo += ast.iter_child_nodes(node)
    return count


def find_circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """The strongly connected components with more than one node (Tarjan)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in sorted(graph.get(node, ())):
            if other not in index:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], index[other])
        if low[node] == index[node]:
            circle = stack[stack.index(node) :]
            del stack[stack.index(node) :]
            if len(circle) > 1:
                found.append(sorted(circle))

    sys.setrecursionlimit(10_000)
    for node in sorted(graph):
        if node not in index:
            visit(node)
    return found


def import_graph() -> dict[str, set[str]]:
    """Which modules each module of the product imports, type-checking imports included."""
    trees = {module_name(path): parse_file(path) for path in product_files()}
    modules = set(trees)
    graph: dict[str, set[str]] = {}
    for name, tree in trees.items():
        found: set[str] = set()
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module:
                for alias in node.names:
                    full = f"{node.module}.{alias.name}"
                    found.add(full if full in modules else node.module)
        graph[name] = (found & modules) - {name}
    return graph


def folder_graph(graph: dict[str, set[str]]) -> dict[str, set[str]]:
    """The imports between packages. A package's own modules and its parents' are left out."""
    folders: dict[str, set[str]] = {}
    packages = {name.rpartition(".")[0] for name in graph}
    for name, others in graph.items():
        here = name if name in packages else name.rpartition(".")[0]
        for other in others:
            there = other if other in packages else other.rpartition(".")[0]
            if there != here:
                folders.setdefault(here, set()).add(there)
    return folders


def files_per_folder() -> dict[Path, int]:
    """Python files in each folder of the product."""
    found: dict[Path, int] = {}
    for path in product_files():
        found[path.parent] = found.get(path.parent, 0) + 1
    return found


def exceptions_outside_tree() -> list[str]:
    """Exception classes that do not derive from `TuttiError`."""
    bases: dict[str, list[str]] = {}
    for path in product_files():
        for node in ast.walk(parse_file(path)):
            if isinstance(node, ast.ClassDef):
                bases[node.name] = [ast.unparse(base).rpartition(".")[2] for base in node.bases]

    def roots(name: str) -> set[str]:
        return {name} | {root for base in bases.get(name, ()) for root in roots(base)}

    builtin = {name for name in dir(__builtins__) if name.endswith(("Error", "Exception"))} | {
        "Exception",
        "ValueError",
    }
    return [name for name in bases if roots(name) & builtin and "TuttiError" not in roots(name)]


def measure() -> dict[str, str]:
    """All figures by name, as text."""
    functions: list[Function] = []
    classes: list[ast.ClassDef] = []
    asserts = logs = adapter_lines = lines = 0
    naming_makes = 0
    for path in product_files():
        text = path.read_text(encoding="utf-8")
        relative = path.relative_to(ROOT)
        lines += len(text.splitlines())
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, Function) and not node.name.startswith("__"):
                functions.append(node)
            elif isinstance(node, ast.ClassDef):
                classes.append(node)
        asserts += len(re.findall(r"assert self\.\w+ is not None|assert \w+ is not None", text))
        if relative.parts[0] == "adapters":
            adapter_lines += len(text.splitlines())
            logs += len(re.findall(r"log(?:ger)?\.(?:debug|info|warning|error)\(", text))
        own = set(relative.parts) & {*MAKES, "yaskawa"}
        if not own and any(re.search(rf"\b{make}\b", text, re.IGNORECASE) for make in MAKES):
            naming_makes += 1
    circles = find_circles(import_graph())
    one_word = [is_one_word(each.name) for each in functions]
    return {
        "functions with a one-word name": f"{100 * sum(one_word) / len(one_word):.0f} %",
        "classes with a one-word name": f"{100 * sum(is_one_word(c.name) for c in classes) / len(classes):.0f} %",
        "median length of a function's name": f"{median(len(each.name) for each in functions):.0f}",
        "README, lines": str(len((ROOT / "README.md").read_text(encoding="utf-8").splitlines())),
        "most files in one folder": str(max(files_per_folder().values())),
        "circles of imports": str(len(circles)),
        "longest circle of imports, files": str(max((len(circle) for circle in circles), default=0)),
        "exceptions outside the tree": str(len(exceptions_outside_tree())),
        "classes over 250 lines": str(sum((c.end_lineno or 0) - c.lineno >= MAX_CLASS_LINES for c in classes)),
        "functions over complexity 12": str(sum(complexity(each) > MAX_COMPLEXITY for each in functions)),
        "asserts for 'connected'": str(asserts),
        "files outside a make's folder that name a make": str(naming_makes),
        "log calls per 1,000 lines of adapters": f"{1000 * logs / adapter_lines:.1f}",
        "local names that are no nouns, per 1,000 lines": f"{measure_product(ROOT):.1f}",
        "product lines": str(lines),
    }


def main() -> None:
    """Print the figures, and the circles that are left."""
    print(f"{'figure':<50}{'15ec78a':>10}{'now':>10}")
    for name, value in measure().items():
        print(f"{name:<50}{BEFORE.get(name, ''):>10}{value:>10}")
    for kind, graph in (("files", import_graph()), ("folders", folder_graph(import_graph()))):
        for circle in find_circles(graph):
            print(f"circle of {kind}: {', '.join(circle)}")


if __name__ == "__main__":
    main()
