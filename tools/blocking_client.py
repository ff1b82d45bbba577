"""Write `orchestrator/client/blocking.py`: every method of the asynchronous API without `async`.

The signatures and docstrings are copied, so that `help()` and editors show them. `--check` fails if the file is old.
"""

import ast
import importlib
import inspect
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
TARGET = ROOT / "orchestrator" / "client" / "blocking.py"

HEAD = '''"""The Python API without `async`, for scripts and notebooks.

with BlockingTutti("tcp/127.0.0.1:7447") as tutti:
    tutti.home()
    tutti.move({"gantry.x": 120})
    print(tutti.position("gantry.x"))

Written by `tools/blocking_client.py` from the asynchronous API; a change belongs there. Ctrl-C stops what the
interrupted call has begun, and says so; a job that was submitted stays in the queue.
"""
'''

TUTTI_START = '''
    def __init__(
        self,
        connect: str | Bus = DEFAULT_ENDPOINT,
        fleet: str | None = None,
        actor: str = "api",
        worker: Worker | None = None,
    ) -> None:
        """worker: runs the requests; None: a thread of its own."""
        super().__init__(Tutti(connect, fleet, actor), worker or LoopThread())
        self._closed = False

    def connect(self) -> Self:
        """Connect, for a notebook; entering the context does it, and `close` ends it. Raises `RouterUnreachable`, or
        `Refusal` with code `no-fleet` or `which-fleet`."""
        try:
            self._run(self._wrapped.open())
        except BaseException:
            self.close()
            raise
        return self

    def __enter__(self) -> Self:
        return self.connect()

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection. May be called twice."""
        if not self._closed:
            self._closed = True
            self._run(self._wrapped.close())
            self._worker.close()
'''
CONTEXT = """
    def __enter__(self) -> Self:
        self._run(self._wrapped.__aenter__())
        return self

    def __exit__(self, *error: object) -> None:
        self._run(self._wrapped.__aexit__(*error))
"""

# asynchronous class: (blocking class, is a context, properties and attributes)
CLASSES = {
    "SubmittedJob": ("BlockingJob", False, ("id", "waits_for")),
    "ManualControl": ("BlockingManualControl", True, ("axes", "lost", "holder")),
    "ArmedMove": ("BlockingArmedMove", False, ("number", "lead_s", "most_lead_s", "until_fleet_ns")),
    "LiveJob": ("BlockingLiveJob", True, ("id", "axes", "result")),
    "Attendance": ("BlockingAttendance", True, ("session",)),
    "Tutti": ("BlockingTutti", False, ("actor",)),
}
# They handle the bus itself, or belong to others that are there.
LEFT_OUT = {
    "bus", "keys", "open", "close", "request_fields", "request_service", "request_controller", "subscribe_samples",
    "follow_all",
    "find_absence", "show_job_when_available", "load_result", "acquire", "read_point_parts",
}  # fmt: skip
ATTRIBUTES = {
    "id": ("str", "The id as plain text."),
    "waits_for": ("str", "What the job waited for when it was submitted; empty: nothing."),
    "axes": ("list[str]", "The axes that it has, as they were named or as `controller.axis`."),
    "number": ("int", "The number of the step in its live job."),
    "lead_s": ("float", "From `go` to the start of the axes, s, as things were when it was armed."),
    "most_lead_s": ("float", "The same at most: `go` comes while the controllers are being loaded anew."),
    "until_fleet_ns": ("int", "The end of the wait, fleet time, ns."),
    "result": ("JobResult | None", "The record of the job; None while it runs."),
    "lost": ("Refusal | None", "Why the lease ended before it was released; None while it lasts."),
    "holder": ("str", "The holder of the lease, as others are shown it."),
    "session": ("str", "The session, for the terms of jobs that belong to it."),
    "actor": ("str", "The user or program that makes the requests."),
}


class Imports:
    """The imports that the copied signatures need."""

    def __init__(self) -> None:
        self.found: dict[str, str] = {}

    def add_names(self, text: str, module: str) -> None:
        """Find where the names in `text`, of a signature in `module`, come from."""
        known = _names_of_module(module)
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Name) and node.id in known:
                self.found[node.id] = known[node.id]

    def render(self) -> str:
        by_module: dict[str, list[str]] = {}
        for name, module in self.found.items():
            by_module.setdefault(module, []).append(name)
        return "\n".join(
            f"from {module} import {', '.join(sorted(names))}" for module, names in sorted(by_module.items())
        )


def _names_of_module(module: str) -> dict[str, str]:
    """Where each name that `module` imports or defines comes from."""
    tree = ast.parse(Path(inspect.getfile(importlib.import_module(module))).read_text(encoding="utf-8"))
    names: dict[str, str] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            names |= {each.asname or each.name: node.module for each in node.names}
    for node in tree.body:
        if isinstance(node, ast.ClassDef):
            names[node.name] = module
        elif isinstance(node, ast.Assign):
            names |= {target.id: module for target in node.targets if isinstance(target, ast.Name)}
    return names


def _unquote(text: str) -> str:
    """Annotations without the quotes of forward references."""
    tree = ast.parse(text, mode="eval").body if text else None

    class Unquote(ast.NodeTransformer):
        def visit_Constant(self, node: ast.Constant) -> ast.expr:
            return ast.parse(node.value, mode="eval").body if isinstance(node.value, str) else node

        def visit_Subscript(self, node: ast.Subscript) -> ast.expr:
            if isinstance(node.value, ast.Name) and node.value.id == "Literal":
                return node
            self.generic_visit(node)
            return node

    return ast.unparse(Unquote().visit(tree)) if tree is not None else ""


def _write_method(node: ast.FunctionDef | ast.AsyncFunctionDef, module: str, imports: Imports) -> str:
    arguments = node.args
    for each in (*arguments.args, *arguments.kwonlyargs, *([arguments.vararg] if arguments.vararg else [])):
        if each.annotation is not None:
            text = _unquote(ast.unparse(each.annotation))
            imports.add_names(text, module)
            each.annotation = ast.parse(text, mode="eval").body
    for default in (*arguments.defaults, *(each for each in arguments.kw_defaults if each is not None)):
        imports.add_names(ast.unparse(default), module)
    returned = _unquote(ast.unparse(node.returns)) if node.returns else "None"
    given = [each.arg for each in arguments.args[1:]]
    given += [f"*{arguments.vararg.arg}"] if arguments.vararg else []
    given += [f"{each.arg}={each.arg}" for each in arguments.kwonlyargs]
    call = f"self._wrapped.{node.name}({', '.join(given)})"
    if returned.startswith("AsyncGenerator["):
        item = returned.removeprefix("AsyncGenerator[").removesuffix("]")
        imports.add_names(item, module)
        imports.found["Iterator"] = "collections.abc"
        returned, body = f"Iterator[{item}]", f"return self._iterate({call})"
    else:
        value = f"self._run({call})" if isinstance(node, ast.AsyncFunctionDef) else call
        if returned in CLASSES:
            blocking = CLASSES[returned][0]
            returned, body = blocking, f"return {blocking}({value}, self._worker)"
        else:
            imports.add_names(returned, module)
            body = f"return {value}" if returned != "None" else value
    doc = ast.get_docstring(node, clean=False)
    lines = [f"    def {node.name}({ast.unparse(arguments)}) -> {returned}:"]
    if doc:
        doc = doc.replace("async with tutti", "with tutti").replace("await ", "")
        lines.append(f'        """{doc}"""')
    return "\n".join([*lines, f"        {body}"])


def write_classes() -> str:
    """The text of the module."""
    from orchestrator.client.api import Tutti
    from orchestrator.client.armed import ArmedMove
    from orchestrator.client.attendance import Attendance
    from orchestrator.client.jobs import SubmittedJob
    from orchestrator.client.live import LiveJob
    from orchestrator.client.manual import ManualControl

    imports = Imports()
    parts: list[str] = []
    for wrapped in (SubmittedJob, ManualControl, ArmedMove, LiveJob, Attendance, Tutti):
        name, is_context, attributes = CLASSES[wrapped.__name__]
        imports.found[wrapped.__name__] = wrapped.__module__
        doc = inspect.getdoc(wrapped) or ""
        text = [f"class {name}(BlockingObject[{wrapped.__name__}]):", f'    """{_shorten(doc)}"""']
        if name == "BlockingTutti":
            text.append(TUTTI_START)
        if is_context:
            text.append(CONTEXT)
        for attribute in attributes:
            imports.found |= {"Refusal": "orchestrator.model.errors"} if attribute == "lost" else {}
            kind, doc = ATTRIBUTES[attribute]
            text.append(
                f"    @property\n    def {attribute}(self) -> {kind}:\n"
                f'        """{doc}"""\n        return self._wrapped.{attribute}'
            )
        done: set[str] = set(LEFT_OUT)
        for base in wrapped.__mro__:
            if not base.__module__.startswith("orchestrator.client"):
                continue
            tree = ast.parse(Path(inspect.getfile(base)).read_text(encoding="utf-8"))
            (body,) = [node.body for node in tree.body if isinstance(node, ast.ClassDef) and node.name == base.__name__]
            for node in body:
                if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) or node.name in done:
                    continue
                is_property = any(isinstance(each, ast.Name) and each.id == "property" for each in node.decorator_list)
                done.add(node.name)
                if not node.name.startswith("_") and not is_property:
                    text.append(_write_method(node, base.__module__, imports))
        parts.append("\n\n".join(text))
    imports.found |= {"Self": "typing", "Bus": "orchestrator.bus.base", "DEFAULT_ENDPOINT": "orchestrator.bus.endpoint"}
    imports.found |= dict.fromkeys(("BlockingObject", "LoopThread", "Worker"), "orchestrator.client.worker")
    text = "\n".join([HEAD, imports.render(), "", *parts, ""])
    for command in (["check", "--select", "I", "--fix"], ["format"]):
        text = _run_ruff(command, text)
    return text


def _shorten(doc: str) -> str:
    return doc.split("\n\n")[0].replace("\n", "\n    ")


def _run_ruff(command: list[str], text: str) -> str:
    ruff = Path(sys.executable).with_name("ruff")
    done = subprocess.run(
        [ruff, *command, "--quiet", "--stdin-filename", str(TARGET), "-"],
        input=text,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout


if __name__ == "__main__":
    fresh = write_classes()
    if "--check" in sys.argv:
        current = TARGET.read_text(encoding="utf-8") if TARGET.exists() else ""
        raise SystemExit(None if current == fresh else f"{TARGET} is old: run `python tools/blocking_client.py`")
    TARGET.write_text(fresh, encoding="utf-8")
