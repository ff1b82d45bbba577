"""How steps are counted: from 0 in fields and addresses for programs, from 1 in what people read and type."""


def number_step(index: int) -> int:
    """The number of a step in texts, tables and on the command line. index: from 0, as in all fields."""
    return index + 1


def name_step(index: int) -> str:
    """A step by its number, in words: `step 2`. index: from 0."""
    return f"step {number_step(index)}"
