"""Write the generated reference pages: fields of files, command line, Python interface. `make docs` runs it."""

import inspect
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, get_args

import click
from click.testing import CliRunner
from pydantic import BaseModel

import tutti
import tutti.testing
from orchestrator.cli.main import main as command
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.job import Job
from orchestrator.model.numbers import format_ns
from orchestrator.model.templates.button import ButtonDeclaration
from orchestrator.model.templates.parameters import ParameterDeclarations

WITH_MEMBERS = ("orchestrator.client", "orchestrator.testing", "orchestrator.model.templates")
REFERENCE = Path(__file__).parents[1] / "docs" / "reference"


def type_text(schema: dict[str, Any]) -> str:
    """A field's type in words, with links to the tables of other models."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "const" in schema:
        return f"`{schema['const']}`"
    if "enum" in schema:
        return ", ".join(f"`{value}`" for value in schema["enum"])
    if "anyOf" in schema or "oneOf" in schema:
        parts = [type_text(each) for each in schema.get("anyOf", schema.get("oneOf", []))]
        return " or ".join(dict.fromkeys(part for part in parts if part != "null"))
    match schema.get("type"):
        case "array":
            items = schema.get("items", {})
            return f"list of {type_text(items)}" if items else "list"
        case "object":
            values = next(iter(schema.get("patternProperties", {}).values()), schema.get("additionalProperties"))
            return f"mapping to {type_text(values)}" if isinstance(values, dict) else "mapping"
        case str() as name:
            return name
        case _:
            return "value"


def default_text(schema: dict[str, Any], *, required: bool) -> str:
    """A field's default; *required* without one."""
    if required:
        return "*required*"
    default = schema.get("default")
    if isinstance(default, int) and schema.get("type") == "string":
        return f"`{format_ns(default)}`"  # a duration
    return "" if default in (None, [], {}, "") else f"`{default}`"


def model_tables(schema: dict[str, Any], title: str) -> Iterator[str]:
    """One section per model: its description and the table of its fields."""
    models = {title: schema, **schema.get("$defs", {})}
    for name, model in models.items():
        fields = model.get("properties", {})
        if "enum" in model:
            yield f"## {name}\n\n{model.get('description', '')}\n\nOne of {type_text(model)}.\n"
        if not fields:
            continue
        yield f"## {name}\n"
        if model.get("description"):
            yield model["description"].replace("\n\n", "\n").strip() + "\n"
        yield "| field | type | default | meaning |"
        yield "|---|---|---|---|"
        for field, details in fields.items():
            required = field in model.get("required", [])
            meaning = details.get("description", "").replace("\n", " ").replace("|", "\\|")
            kind = type_text(details).replace("|", "\\|")
            yield f"| `{field}` | {kind} | {default_text(details, required=required)} | {meaning} |"
        yield ""


def file_page(kind: str, schema: dict[str, Any], title: str) -> str:
    """The page of a kind of file."""
    head = (
        f"# Fields of a {kind} file\n\nGenerated from the schema; `tutti schema {kind}` prints it for editors. "
        f"An example is `deploy/examples/demo.{kind}.yaml`.\n"
    )
    return "\n".join([head, *model_tables(schema, title)])


def fleet_page() -> str:
    """The page of fleet files: the fields of a fleet, and how entries are written in short."""
    head, first_table = file_page("fleet", Fleet.model_json_schema(), "Fleet").split("\n## ", 1)
    section = "../how-to/write-a-fleet.md#many-controllers-that-are-alike"
    text = f"Entries that stand for many (`count`, `each`) and fragments (`include`): [how-to]({section})."
    return f"{head}{text}\n\n## {first_table}"


def job_page() -> str:
    """The page of job files: the fields of a job, and the parts of its file alone: parameters and button."""
    declarations = model_tables(ParameterDeclarations.model_json_schema(), "Parameters")
    button = model_tables(ButtonDeclaration.model_json_schema(), "Button")
    return "\n".join([file_page("job", Job.model_json_schema(), "Job"), *declarations, *button])


def commands(group: click.Command, words: list[str]) -> Iterator[tuple[list[str], click.Command]]:
    """All commands below `group`, depth first."""
    yield words, group
    if isinstance(group, click.Group):
        context = click.Context(group)
        for name in group.list_commands(context):
            found = group.get_command(context, name)
            if found is not None:
                yield from commands(found, [*words, name])


def command_page() -> str:
    """The page of the command line: each command's help."""
    runner = CliRunner()
    parts = ["# Command line\n", "Generated from the commands' own help.\n"]
    for words, _ in commands(command, []):
        shown = runner.invoke(command, [*words, "--help"], prog_name="tutti", terminal_width=100)
        parts += [f"## {' '.join(['tutti', *words])}\n", "```text", shown.output.rstrip(), "```\n"]
    return "\n".join(parts)


def python_page() -> str:
    """The page of the Python interface: every public name of `tutti`, its signature and its docstring."""
    return "\n".join(["# Python interface\n", *_describe_module(tutti)])


def testing_page() -> str:
    """The page of `tutti.testing`."""
    return "\n".join(["# Python interface for tests\n", *_describe_module(tutti.testing)])


def _describe_module(module: ModuleType) -> Iterator[str]:
    yield (inspect.getdoc(module) or "").partition("\n")[0] + " Generated from the code.\n"
    for name in module.__all__:
        found = getattr(module, name)
        yield f"## {name}\n"
        if name == "Step":
            yield f"One of {', '.join(each.__name__ for each in get_args(get_args(found)[0]))}.\n"
            continue
        yield from _describe_object(name, found)
        waiting = name.removeprefix("Blocking") if name.startswith("Blocking") else ""
        if waiting:
            same = {"Job": "SubmittedJob"}.get(waiting, waiting)
            yield f"It has every method of [{same}](#{same.lower()}), with the same arguments, without `async`.\n"
        elif inspect.isclass(found) and found.__module__.startswith(WITH_MEMBERS):
            yield from _describe_members(name, found)


def _describe_members(name: str, found: type) -> Iterator[str]:
    for part, value in inspect.getmembers(found, lambda each: inspect.isroutine(each) or isinstance(each, property)):
        if not part.startswith("_") and part not in dir(BaseModel) and _is_ours(value):
            yield f"### {name}.{part}\n"
            yield from _describe_object(part, value)


def _is_ours(value: Any) -> bool:
    code = value.fget if isinstance(value, property) else value
    return (getattr(code, "__module__", "") or "").startswith(("orchestrator", "tutti"))


def _describe_object(name: str, found: Any) -> Iterator[str]:
    """Signature and docstring; of a model, its fields instead of the signature."""
    doc = inspect.getdoc(found) or ""
    if inspect.isclass(found) and issubclass(found, BaseModel):
        fields = ", ".join(f"`{field.alias or key}`" for key, field in found.model_fields.items())
        yield f"```text\n{doc}\n```\n"
        yield f"Fields: {fields}.\n"
        return
    if callable(found) and not (inspect.isclass(found) and issubclass(found, dict | Exception)):
        shown = str(inspect.signature(found)).replace("orchestrator.model.", "").replace("collections.abc.", "")
        yield f"`{name}{_shorten_types(shown)}`\n"
    yield f"```text\n{doc}\n```\n"


def _shorten_types(signature: str) -> str:
    """Types without their modules, and without what validates them."""
    signature = re.sub(r"<function .*? at 0x[0-9a-f]+>", "…", signature)
    plain = re.sub(r"typing\.|pathlib\.|\b(?:[a-z_]+\.)+(?=[A-Z])", "", signature)
    return plain if len(plain) < 400 else re.sub(r"\(.*\)", "(…)", plain, flags=re.DOTALL)


def pages() -> dict[str, str]:
    """The generated pages by file name."""
    return {
        "fleet-file.md": fleet_page(),
        "job-file.md": job_page(),
        "command-line.md": command_page(),
        "python.md": python_page(),
        "testing.md": testing_page(),
    }


def main() -> int:
    """Write the pages; with `--check` only report which are out of date, as exit code 1."""
    check, stale = "--check" in sys.argv, list[str]()
    for name, text in pages().items():
        path = REFERENCE / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            stale.append(name)
            if not check:
                path.write_text(text, encoding="utf-8")
    if check and stale:
        print(f"out of date: {', '.join(stale)}; run `make docs`")
    return 1 if check and stale else 0


if __name__ == "__main__":
    sys.exit(main())
