"""The frames of a CANopen bus in words: service, node, objects and their values."""

from collections.abc import Sequence

from adapters.cia402.canopen import bus, states
from adapters.cia402.canopen import objects as o
from adapters.cia402.canopen.objects import DictionaryObject
from adapters.cia402.canopen.pdos import PdoMapping
from adapters.cia402.canopen.words import abort_text, emergency_text
from adapters.cia402.mapping.required import PdoTimes, required_pdos
from adapters.cia402.options import Cia402Options
from adapters.toolkit.frames import DecodedFrame, FrameDirection, printable_text
from orchestrator.link.can import CanFrame, FrameReader

_NMT = {
    bus.NMT_START: "start",
    bus.NMT_STOP: "stop",
    bus.NMT_PRE_OPERATIONAL: "pre-operational",
    bus.NMT_RESET: "reset",
    0x82: "reset communication",
}
_NMT_STATES = {0x00: "boots", 0x04: "stopped", bus.OPERATIONAL: "operational", 0x7F: "pre-operational"}
_CONTROLWORDS = {
    states.DISABLE_VOLTAGE: "disable voltage",
    states.QUICK_STOP: "quick stop",
    states.SHUTDOWN: "shutdown",
    states.SWITCH_ON: "switch on",
    states.ENABLE: "enable operation",
    states.FAULT_RESET: "fault reset",
}
_CONTROL_BITS = {states.NEW_SET_POINT: "new set-point", states.AT_ONCE: "at once", states.HALT: "halt"}
_NODE = 0x7F
_STATE_BITS = 0x8F  # of the controlword


class Cia402Decoder:
    """Frames of all nodes of a bus, with the mapping of PDOs that the adapter loads."""

    def __init__(self, options: Cia402Options) -> None:
        self._readers = {"out": FrameReader(), "in": FrameReader()}
        # Which of the mappings a drive has shows in the length.
        self._pdos: dict[tuple[int, int], PdoMapping] = {}
        self._following: set[int] = set()
        """Nodes that follow positions: only these have a TPDO 4."""
        times = PdoTimes(options.state_ms, options.inhibit_ms)
        for outputs in (False, True):
            for followed_object in (None, *o.FOLLOWED.values()):
                for pdo in required_pdos(times, outputs=outputs, followed=followed_object):
                    length = sum(carried_object.byte_size for carried_object in pdo.carries)
                    self._pdos.setdefault((pdo.function, length), pdo)
        pdos = required_pdos(times, outputs=True, followed=o.TARGET)
        # As long as the mapping of ramps.
        self._switched = next(pdo for pdo in pdos if pdo.function == bus.RPDO[3])

    def decode_bytes(self, direction: FrameDirection, data: bytes) -> list[DecodedFrame]:
        try:
            frames = self._readers[direction].add_bytes(data)
        except ValueError:
            self._readers[direction] = FrameReader()
            return [DecodedFrame(printable_text(data), "no CAN frames")]
        return [self._describe_frame(frame) for frame in frames]

    def _describe_frame(self, frame: CanFrame) -> DecodedFrame:
        text, node = str(frame), frame.id & _NODE
        if frame.error:
            return DecodedFrame(text, "error frame of this end's CAN controller")
        if frame.extended or frame.rtr:
            return DecodedFrame(text, "no frame of CANopen's predefined connection set")
        if frame.id == 0 and len(frame.data) >= 2:
            nodes = f"node {frame.data[1]}" if frame.data[1] else "all nodes"
            return DecodedFrame(text, f"NMT {_NMT.get(frame.data[0], f'command {frame.data[0]}')}: {nodes}")
        if frame.id == bus.SYNC.id:
            return DecodedFrame(text, "SYNC")
        if frame.id & ~_NODE == bus.TPDO[3]:
            self._following.add(node)
        return DecodedFrame(text, self._describe_service(node, frame.id & ~_NODE, frame.data), f"node {node}")

    def _describe_service(self, node: int, function: int, data: bytes) -> str:
        if function == bus.EMCY and len(data) >= 2:
            code = int.from_bytes(data[:2], "little")
            return f"EMCY {emergency_text(code)}" if code else "EMCY no error any more"
        if function == bus.HEARTBEAT and data:
            return f"heartbeat: {_NMT_STATES.get(data[0] & _NODE, f'state {data[0]}')}"
        if function in (bus.SDO_REQUEST, bus.SDO_ANSWER) and len(data) == 8:
            return _describe_sdo(data, is_request=function == bus.SDO_REQUEST)
        pdo = self._pdos.get((function, len(data)))
        if function == bus.RPDO[3] and len(data) == 8 and node in self._following:
            pdo = self._switched
        if pdo is not None:
            return f"{pdo.title} {_describe_values(pdo.carries, data)}"
        return ""


def _describe_sdo(data: bytes, *, is_request: bool) -> str:
    specifier, (index, sub) = data[0] >> 5, (int.from_bytes(data[1:3], "little"), data[3])
    obj = o.BY_ADDRESS.get((index, sub))
    name = str(obj) if obj is not None else f"{index:04X}h:{sub:02X}"
    if specifier == 4:
        return f"SDO abort {name}: {abort_text(int.from_bytes(data[4:], 'little'))}"
    # Expedited transfers (CiA 301): bits 2 and 3 are the number of unused bytes.
    value = data[4 : 8 - (data[0] >> 2 & 3)] if data[0] & 0x02 else b""
    if is_request:
        match specifier:
            case 1:
                return f"SDO write {name} = {_format_value(obj, value)}"
            case 2:
                return f"SDO read {name}"
            case _:
                return "SDO segment"
    match specifier:
        case 2:
            return f"SDO {name} is {_format_value(obj, value)}" if value else f"SDO {name} follows in segments"
        case 3:
            return f"SDO {name} is written"
        case _:
            return f"SDO segment {printable_text(data[1:])}"


def _describe_values(carries: Sequence[DictionaryObject], data: bytes) -> str:
    words: list[str] = []
    for carried_object in carries:
        words.append(f"{carried_object.name} {_format_value(carried_object, data[: carried_object.byte_size])}")
        data = data[carried_object.byte_size :]
    return ", ".join(words)


def _format_value(obj: DictionaryObject | None, data: bytes) -> str:
    if obj is None or not obj.byte_size:
        return f"{int.from_bytes(data, 'little')}"
    value = obj.decode(data)
    if obj == o.STATUSWORD:
        target_text = ", target reached" if value & states.TARGET_REACHED else ""
        return f"{value:04X}h ({states.drive_state_of(value).value}{target_text})"
    if obj == o.CONTROLWORD:
        bits = [word for bit, word in _CONTROL_BITS.items() if value & bit]
        return f"{value:04X}h ({', '.join([_CONTROLWORDS.get(value & _STATE_BITS, 'unknown'), *bits])})"
    return f"{value:#x}" if obj in (o.INPUTS, o.OUTPUTS) else str(value)
