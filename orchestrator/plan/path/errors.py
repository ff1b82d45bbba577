"""What a path is refused for, by piece."""

from orchestrator.model.errors import Refusal


class PathRefusal(Refusal):
    """A path that cannot be planned; nothing has moved. piece: its number, from 1 as people count; None: the path."""

    def __init__(self, code: str, text: str, remedy: str, piece: int | None = None) -> None:
        super().__init__(code, text, remedy)
        self.piece = piece
