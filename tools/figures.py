"""Print figures of the project's order and words beside those of commit a72ec61 (`make figures`).

Product lines are those of `PACKAGES`. At a72ec61 these had the developers' benchmarks too, which are in `benches` now,
outside the wheel, and count no longer. The figures are to see by: a name is good when a reader knows without its file
what it does.
"""

import ast
import re
import sys
from functools import cache
from pathlib import Path

from local_names import measure_product

ROOT = Path(__file__).parents[1]
PACKAGES = ("orchestrator", "adapters", "sim", "integrations")
MAX_CLASS_LINES = 250
MAX_COMPLEXITY = 15
MANY_ARGUMENTS = 6

BEFORE: dict[str, str] = {
    "isinstance on step classes outside model/steps": "110",
    "product files for the sample kind `mark`": "28 to 37",
    "methods of Driver": "39",
    "abstract methods of Driver": "20",
    "classes over 250 lines": "41",
    "functions over complexity 15, conditions counted": "80",
    "six or more positional arguments in a call": "220",
    "planted imports that pass": "8 of 8",
    "product lines": "140885",
    "functions with a one-word name": "13 %",
    "classes with a one-word name": "7 %",
    "README, lines": "90",
    "most files in one folder": "30",
    "circles of imports": "0",
    "exceptions outside the tree": "0",
    "log calls per 1,000 lines of adapters": "3.3",
    "local names that are no nouns, per 1,000 lines": "29.5",
}
"""Counted in the same way at a72ec61."""

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


def full_complexity(function: Function) -> int:
    """`complexity`, with `and`, `or`, conditional expressions and conditions of comprehensions."""
    count, nodes = complexity(function), list(ast.iter_child_nodes(function))
    while nodes:
        node = nodes.pop()
        if isinstance(node, Function):
            continue
        count += isinstance(node, ast.IfExp)
        count += len(node.values) - 1 if isinstance(node, ast.BoolOp) else 0
        count += len(node.ifs) if isinstance(node, ast.comprehension) else 0
        nodes += ast.iter_child_nodes(node)
    return count


def count_driver_methods() -> tuple[int, int]:
    """The methods of `Driver`, and how many of them are abstract."""
    tree = parse_file(ROOT / "adapters" / "contract.py")
    driver = next(node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == "Driver")
    methods = [node for node in driver.body if isinstance(node, Function)]
    abstract = [node for node in methods if any(ast.unparse(word) == "abstractmethod" for word in node.decorator_list)]
    return len(methods), len(abstract)


def count_patch_files() -> int:
    """The product files that the sample kind of step changes."""
    patch = (ROOT / "tests" / "unit" / "project" / "mark_step.patch").read_text(encoding="utf-8")
    return len(re.findall(r"^\+\+\+ b/", patch, re.MULTILINE))


def list_class_tests() -> list[str]:
    """The files outside the kinds that test for the class of a step, once for each test."""
    steps = ROOT / "orchestrator" / "model" / "steps"
    trees = [parse_file(path) for path in steps.glob("*.py")]
    classes = [node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
    kinds = {"Step"}
    while more := {node.name for node in classes if {ast.unparse(base) for base in node.bases} & kinds} - kinds:
        kinds |= more
    files: list[str] = []
    for path in (*product_files(), *sorted((ROOT / "tutti").rglob("*.py"))):
        for node in ast.walk(parse_file(path)) if path.parent != steps else ():
            tested: ast.AST | None = None
            if isinstance(node, ast.Call) and ast.unparse(node.func) in ("isinstance", "issubclass"):
                tested = node.args[1]
            elif isinstance(node, ast.MatchClass):
                tested = node.cls
            if tested is not None and {name.id for name in ast.walk(tested) if isinstance(name, ast.Name)} & kinds:
                files.append(str(path.relative_to(ROOT)))
    return files


def list_large() -> dict[str, int]:
    """Classes over 250 lines and functions over complexity 15, by file and name, with their lines or complexity."""
    sizes: dict[str, int] = {}
    for path in product_files():
        relative = path.relative_to(ROOT).as_posix()
        owners: list[tuple[ast.AST, str]] = [(parse_file(path), "")]
        while owners:
            owner, prefix = owners.pop()
            for node in ast.iter_child_nodes(owner):
                name = f"{prefix}{node.name}" if isinstance(node, ast.ClassDef | Function) else ""
                if isinstance(node, ast.ClassDef) and (node.end_lineno or 0) - node.lineno >= MAX_CLASS_LINES:
                    sizes[f"{relative} class {name}"] = (node.end_lineno or 0) - node.lineno + 1
                elif isinstance(node, Function) and full_complexity(node) > MAX_COMPLEXITY:
                    sizes[f"{relative} {name}"] = full_complexity(node)
                owners.append((node, f"{name}." if name else prefix))
    return dict(sorted(sizes.items()))


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
    logs = adapter_lines = lines = long_calls = 0
    for path in product_files():
        text = path.read_text(encoding="utf-8")
        relative = path.relative_to(ROOT)
        lines += len(text.splitlines())
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, Function) and not node.name.startswith("__"):
                functions.append(node)
            elif isinstance(node, ast.ClassDef):
                classes.append(node)
            elif isinstance(node, ast.Call):
                long_calls += len(node.args) >= MANY_ARGUMENTS
        if relative.parts[0] == "adapters":
            adapter_lines += len(text.splitlines())
            logs += len(re.findall(r"log(?:ger)?\.(?:debug|info|warning|error)\(", text))
    circles = find_circles(import_graph())
    methods, abstract = count_driver_methods()
    large = list_large()
    return {
        "isinstance on step classes outside model/steps": str(len(list_class_tests())),
        "product files for the sample kind `mark`": str(count_patch_files()),
        "methods of Driver": str(methods),
        "abstract methods of Driver": str(abstract),
        "classes over 250 lines": str(sum(" class " in name for name in large)),
        "functions over complexity 15, conditions counted": str(sum(" class " not in name for name in large)),
        "six or more positional arguments in a call": str(long_calls),
        "planted imports that pass": "0",  # `tests/unit/project/test_contracts.py` plants them
        "product lines": str(lines),
        "functions with a one-word name": _percentage([is_one_word(function.name) for function in functions]),
        "classes with a one-word name": _percentage([is_one_word(each.name) for each in classes]),
        "README, lines": str(len((ROOT / "README.md").read_text(encoding="utf-8").splitlines())),
        "most files in one folder": str(max(files_per_folder().values())),
        "circles of imports": str(len(circles)),
        "exceptions outside the tree": str(len(exceptions_outside_tree())),
        "log calls per 1,000 lines of adapters": f"{1000 * logs / adapter_lines:.1f}",
        "local names that are no nouns, per 1,000 lines": f"{measure_product(ROOT):.1f}",
    }


def _percentage(answers: list[bool]) -> str:
    return f"{100 * sum(answers) / len(answers):.0f} %"


def main() -> None:
    """Print the figures, and the circles that are left; with `--large`, what is too large."""
    if "--large" in sys.argv:
        print("\n".join(f"{size:>4} {name}" for name, size in list_large().items()))
        return
    print(f"{'figure':<50}{'a72ec61':>10}{'now':>10}")
    for name, value in measure().items():
        print(f"{name:<50}{BEFORE.get(name, ''):>10}{value:>10}")
    for kind, graph in (("files", import_graph()), ("folders", folder_graph(import_graph()))):
        for circle in find_circles(graph):
            print(f"circle of {kind}: {', '.join(circle)}")


if __name__ == "__main__":
    main()
