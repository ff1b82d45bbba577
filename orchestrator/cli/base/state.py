"""Which state folder of this machine a command means."""

from pathlib import Path

from orchestrator.cli.base.codes import BAD_INPUT
from orchestrator.cli.base.errors import exit_with_error

_NAME_FOLDER = "name the folder, if the fleet was started with --state FOLDER: give the command --state FOLDER too"


def choose_state(state: Path | None, fleet: str | None, part: str, what: str) -> Path:
    """The state folder that has `part`, a file or folder; a choice that is not unique ends the command.

    what: that part in words, plural.
    """
    from orchestrator.runtime.state.folder import default_state, find_running_fleets

    base = default_state("any").parent
    if state is None and fleet is None:
        running_folders = [fleet.folder for fleet in find_running_fleets()]
        folders = running_folders or [path.parent for path in sorted(base.glob(f"*/{part}"))]
        if len(folders) > 1:
            names = ", ".join(folder.name for folder in folders)
            text = f"several fleets {'run' if running_folders else f'have {what}'}: {names}"
            exit_with_error(text, BAD_INPUT, "choose one with --fleet or --state", code="which-fleet")
        if not folders:
            exit_with_error(f"no fleet has {what} below {base}", BAD_INPUT, _NAME_FOLDER)
        state = folders[0]
    folder = state or default_state(fleet or "")
    if not (folder / part).exists():
        exit_with_error(f"{folder} has no {what}", BAD_INPUT, _NAME_FOLDER)
    return folder
