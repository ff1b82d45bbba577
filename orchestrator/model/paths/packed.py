"""Pieces of a long path, kept as JSON: as objects 100,000 of them took 260 MB, as JSON 9."""

from collections.abc import Iterator, Sequence
from typing import Annotated, Any, overload

from pydantic import Field, GetCoreSchemaHandler, TypeAdapter, ValidatorFunctionWrapHandler
from pydantic_core import CoreSchema, core_schema

from orchestrator.model.paths.pieces import MAX_PIECES, Piece

PART_ITEMS = 500  # of a list that are read at once, some 4 ms of work

_PIECES: TypeAdapter[list[Piece]] = TypeAdapter(list[Piece])


class PackedPieces(Sequence[Piece]):
    """Pieces that cannot be changed; 500 at a time become objects where they are read."""

    __slots__ = ("_count", "_part", "_part_number", "_parts")

    def __init__(self, pieces: Sequence[Piece]) -> None:
        self._parts = [
            _PIECES.dump_json(list(pieces[begin : begin + PART_ITEMS])) for begin in range(0, len(pieces), PART_ITEMS)
        ]
        self._count = len(pieces)
        self._part_number, self._part = -1, list[Piece]()

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, index: int) -> Piece: ...

    @overload
    def __getitem__(self, index: slice) -> list[Piece]: ...

    def __getitem__(self, index: int | slice) -> Piece | list[Piece]:
        if isinstance(index, slice):
            return [self[number] for number in range(*index.indices(self._count))]
        number = index + self._count if index < 0 else index
        if not 0 <= number < self._count:
            raise IndexError(f"piece {index} of {self._count}")
        return self._read_part(number // PART_ITEMS)[number % PART_ITEMS]

    def __iter__(self) -> Iterator[Piece]:
        for part in self._parts:
            yield from _PIECES.validate_json(part)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, PackedPieces) and self._parts == other._parts

    __hash__ = None  # pyright: ignore[reportAssignmentType] # as that of a list

    def to_json(self) -> bytes:
        """The pieces as one list."""
        return b"[" + b",".join(part[1:-1] for part in self._parts) + b"]"

    def _read_part(self, number: int) -> list[Piece]:
        """A part; the last one is kept, because the next piece that is asked for is usually in it."""
        if number != self._part_number:
            self._part_number, self._part = number, _PIECES.validate_json(self._parts[number])
        return self._part

    def __getstate__(self) -> tuple[list[bytes], int]:
        return self._parts, self._count

    def __setstate__(self, state: tuple[list[bytes], int]) -> None:
        self._parts, self._count = state
        self._part_number, self._part = -1, []


class _Packing:
    """Packs a long list when it has been checked."""

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        pieces_schema = handler(Annotated[list[Piece], Field(max_length=MAX_PIECES)])
        serializer = core_schema.wrap_serializer_function_ser_schema(_write_pieces, schema=pieces_schema)
        return core_schema.no_info_wrap_validator_function(_check_pieces, pieces_schema, serialization=serializer)


def pack_pieces(pieces: list[Piece]) -> Sequence[Piece]:
    """Pack a long list."""
    return PackedPieces(pieces) if len(pieces) > PART_ITEMS else pieces


def _check_pieces(value: Any, check: ValidatorFunctionWrapHandler) -> Sequence[Piece]:
    return value if isinstance(value, PackedPieces) else pack_pieces(check(value))


def _write_pieces(pieces: Sequence[Piece], write: core_schema.SerializerFunctionWrapHandler) -> Any:
    return write(pieces if isinstance(pieces, list) else list(pieces))


Pieces = Annotated[Sequence[Piece], _Packing]
"""Pieces of a path: a list, or `PackedPieces` of a long one."""
