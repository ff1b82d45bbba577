"""Names of axes, inputs and outputs: `controller.name`."""


def split_name(name: str) -> tuple[str, str]:
    """Split `controller.name` into controller and name; the name is empty for a controller alone."""
    controller, _, rest = name.partition(".")
    return controller, rest


def controller_of(name: str) -> str:
    """The controller of `controller.name`."""
    return name.partition(".")[0]
