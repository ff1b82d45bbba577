"""Work masters: the templates of a folder, by the names of their files."""

from collections.abc import Mapping
from pathlib import Path

from tutti import FileError, Refusal, Template

ENDING = ".job.yaml"


def load_work_masters(folder: Path) -> dict[str, Template]:
    """The templates in the files `NAME.job.yaml` and `NAME.template.job.yaml` of a folder, by NAME. Raises `Refusal`,
    code `bad-templates`, for a folder without any, and with the mistakes of the files."""
    templates: dict[str, Template] = {}
    for path in sorted(folder.glob(f"*{ENDING}")):
        name = path.name.removesuffix(ENDING).removesuffix(".template")
        if name in templates:
            raise Refusal("bad-templates", f"{folder}: two files are the work master {name}", "rename one of them")
        try:
            templates[name] = Template.load(path)
        except FileError as error:
            raise Refusal("bad-templates", str(error), "correct the file, or move it out of the folder") from None
    if not templates:
        raise Refusal("bad-templates", f"{folder} has no file *{ENDING}", "put the templates of the orders there")
    return templates


def choose_work_master(templates: Mapping[str, Template], names: tuple[str, ...]) -> str:
    """The first of `names` that is known. Raises `Refusal`, code `bad-order`."""
    for name in names:
        if name in templates:
            return name
    text = f"the work master {', '.join(names)} is unknown" if names else "the job order names no work master"
    raise Refusal("bad-order", text, f"name one of: {', '.join(templates)}")
