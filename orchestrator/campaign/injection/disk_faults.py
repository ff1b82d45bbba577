"""Faults of the disks that the journal, the e-stop latches and the memories of adapters are on."""

from random import Random
from typing import Any

from orchestrator.campaign.injection.repairs import Repair, do_nothing
from orchestrator.clock.base import NS_PER_MS
from orchestrator.runtime.virtual.fleet import VirtualFleet

SLOW_NS = (10 * NS_PER_MS, 400 * NS_PER_MS)  # for one call, from shortest to longest
MAX_FLIPS = 3

# What the next coordinator reads when it starts; the texts of jobs that have ended are read by people only.
_START_COLUMNS = ("name", "actor", "body", "state", "submitted_utc", "missed", "held_by", "after_job", "expires_utc")


def inject_fault(fleet: VirtualFleet, fault: str, draw: Random) -> Repair:
    """Inject a fault of all disks of a fleet, or of the journal's; return its repair."""
    disks = [fleet.coordinator_disk, *(fleet.host_disks.values() if fault != "journal-full" else ())]
    match fault:
        case "disk-full" | "journal-full":
            for disk in disks:
                disk.full = True
        case "disk-slow":
            for disk in disks:
                disk.draw_delay_ns = lambda: draw.randint(*SLOW_NS)
        case _:  # disk-bit-flip
            for _ in range(draw.randint(1, MAX_FLIPS)):
                flip_bit(fleet, draw)
            return do_nothing

    def repair_disks() -> None:
        for disk in disks:
            disk.full, disk.draw_delay_ns = False, None

    return repair_disks


def flip_bit(fleet: VirtualFleet, draw: Random) -> None:
    """Flip one bit of what the next start reads: of a value in the journal, or of a file."""
    disks = [fleet.coordinator_disk, *fleet.host_disks.values()]
    # Not both copies of anything.
    files = [(disk, name) for disk in disks for name in sorted(disk.files) if not name.endswith(".copy")]
    values = _find_values(fleet)
    number = draw.randrange(len(files) + len(values))
    if number < len(files):
        disk, name = files[number]
        disk.files[name] = _with_flipped_bit(disk.files[name], draw)
    else:
        table, column, row, value = values[number - len(files)]
        new_value = _with_flipped_bit(value, draw)
        fleet.journal.database.write(
            f"UPDATE {table} SET {column} = CAST(? AS TEXT) WHERE rowid = ?",
            (new_value, row),
        )


def _find_values(fleet: VirtualFleet) -> list[tuple[str, str, int, bytes]]:
    """Table, column, row number and value of each text that the next coordinator reads when it starts."""
    db, rows = fleet.journal.database, list[tuple[str, str, int, Any]]()
    rows += [("meta", "value", *row) for row in db.select("SELECT rowid, CAST(value AS BLOB) FROM meta")]
    for job in fleet.journal.list_unfinished():
        for column in _START_COLUMNS:
            query = f"SELECT rowid, CAST({column} AS BLOB) FROM jobs WHERE id = ?"
            rows += [("jobs", column, *row) for row in db.select(query, (job.id,))]
    return [row for row in rows if row[3]]


def _with_flipped_bit(data: bytes, draw: Random) -> bytes:
    bit = draw.randrange(8 * len(data))
    new_data = bytearray(data)
    new_data[bit // 8] ^= 1 << bit % 8
    return bytes(new_data)
