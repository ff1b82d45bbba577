"""Count local names that are no nouns: adverbs, participles and pronouns (`each`, `found`, `before`).

Local names are variables, loop names, names of comprehensions, and parameters of lambdas, but not those of functions,
which calls may name. A name of several words is not judged. `first` and `last` are ordinals, and `bound`, `reading`,
`run` and `timing` are nouns of the field: none is in the list.
"""

import ast
from collections.abc import Iterator
from pathlib import Path

PACKAGES = ("orchestrator", "adapters", "sim", "tutti", "integrations", "benches")

_PRONOUNS = """
    all another any both each either few it many mine much neither none one ones other others ours some such that
    them these this those what which who whose
"""
_ADVERBS = """
    above after again ahead alone already also apart away back before behind below beneath beside between beyond
    earlier ever far farther further here how inside later meanwhile near nearer never next now once only outside
    quite rather same since so soon sooner still then there thus together too twice until when where whole why
    within without yet
"""
_PARTICIPLES = """
    begun being bought broken brought built caught chosen come coming doing done drawn driven fallen fed felt flown
    found getting given going gone got grown having heard held hidden kept known laid left lost made meant met
    missing moving paid put read running said seen sent shown sold sought spent stood taken taught thought thrown
    told torn understood waiting won worn writing written
"""
# Nouns that stand for "where" and "what is left", and say no more than these.
_EMPTY_NOUNS = "place rest"
NO_NOUNS = frozenset(f"{_PRONOUNS} {_ADVERBS} {_PARTICIPLES} {_EMPTY_NOUNS}".split())
NOUNS_IN_ED = frozenset({"breed", "creed", "speed", "thread"})  # of five letters or more

_Comprehension = ast.ListComp | ast.SetComp | ast.DictComp | ast.GeneratorExp
_Scope = ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda | _Comprehension


def is_no_noun(name: str) -> bool:
    """Whether a name is one word which is mostly an adverb, a participle or a pronoun."""
    word = name.strip("_").lower()
    return word in NO_NOUNS or (word.isalpha() and len(word) > 4 and word.endswith("ed") and word not in NOUNS_IN_ED)


def find_local_names(tree: ast.AST) -> Iterator[set[str]]:
    """The local names of each function, lambda and comprehension."""
    for node in ast.walk(tree):
        if not isinstance(node, _Scope):
            continue
        names, outer = set[str](), set[str]()
        for child in ast.iter_child_nodes(node):
            _collect_names(child, names, outer)
        parameters = set[str]() if isinstance(node, _Comprehension) else _list_parameters(node.args)
        yield names | parameters if isinstance(node, ast.Lambda) else names - outer - parameters


def _list_parameters(arguments: ast.arguments) -> set[str]:
    """The names of parameters, without those of lambdas in their defaults."""
    plain = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
    starred = [argument for argument in (arguments.vararg, arguments.kwarg) if argument is not None]
    return {argument.arg for argument in (*plain, *starred)}


def _collect_names(node: ast.AST, names: set[str], outer: set[str]) -> None:
    """Add to `names` what is bound here, outside the scopes in it, and to `outer` what belongs to a scope outside."""
    if isinstance(node, _Scope | ast.ClassDef):
        return
    if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
        names.add(node.id)
    elif isinstance(node, ast.ExceptHandler | ast.MatchAs | ast.MatchStar) and node.name is not None:
        names.add(node.name)
    elif isinstance(node, ast.MatchMapping) and node.rest is not None:
        names.add(node.rest)
    elif isinstance(node, ast.Global | ast.Nonlocal):
        outer.update(node.names)
    for child in ast.iter_child_nodes(node):
        _collect_names(child, names, outer)


def count_in_file(path: Path) -> tuple[int, int]:
    """How many local names of a file are no nouns, and its lines."""
    text = path.read_text(encoding="utf-8")
    count = sum(is_no_noun(name) for names in find_local_names(ast.parse(text)) for name in names)
    return count, len(text.splitlines())


def count_per_folder(root: Path) -> dict[str, tuple[int, int]]:
    """For each folder of the product and the benches, two levels deep (`orchestrator/plan`): such names, and lines."""
    counts: dict[str, tuple[int, int]] = {}
    for path in sorted(path for package in PACKAGES for path in (root / package).rglob("*.py")):
        folder = "/".join(path.relative_to(root).parts[:-1][:2])
        names, lines = counts.get(folder, (0, 0))
        more_names, more_lines = count_in_file(path)
        counts[folder] = names + more_names, lines + more_lines
    return counts


def measure_folders(root: Path) -> dict[str, float]:
    """For each folder of the product and the benches, two levels deep: such names per 1,000 lines."""
    return {folder: 1000 * names / max(1, lines) for folder, (names, lines) in count_per_folder(root).items()}


def measure_product(root: Path) -> float:
    """Such names of product and benches, per 1,000 lines."""
    counts = count_per_folder(root).values()
    return 1000 * sum(names for names, _ in counts) / max(1, sum(lines for _, lines in counts))
