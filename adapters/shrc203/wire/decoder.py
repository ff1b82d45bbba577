"""The frames of an SHRC-203 in words (commands: L300-L5477)."""

from adapters.shrc203.wire.replies import REFUSALS, STATUS, parse_status
from adapters.toolkit.frames import DecodedFrame, PendingCommands, TextDecoder, find_words

# By the beginning of a command; of a query, what is asked.
_WORDS = {
    "*IDN?": "ask identity",
    "!:": "ask ready or busy",
    "Q:": "ask coordinates and states",
    "SRQ:": "ask how the axes have stopped",
    "?:A": "ask absolute target",
    "?:ACS": "ask CONFIG of the stages",
    "?:AN": "ask axis names",
    "?:AP": "ask absolute target, prebuffer",
    "?:AXIS": "ask controllable axes",
    "?:B": "ask speeds of origin return",
    "?:BEEP": "ask beeper",
    "?:BO": "ask display",
    "?:C": "ask excitation",
    "?:CMD": "ask previous command",
    "?:D": "ask speeds",
    "?:E": "ask arc",
    "?:EP": "ask arc, prebuffer",
    "?:F": "ask loop",
    "?:FMT": "ask command format",
    "?:J": "ask jog",
    "?:K": "ask line",
    "?:KP": "ask line, prebuffer",
    "?:L": "ask program loops",
    "?:M": "ask relative amount",
    "?:MODE": "ask mode",
    "?:MP": "ask relative amount, prebuffer",
    "?:N": "ask model",
    "?:O": "ask outputs",
    "?:P": "ask nm per pulse",
    "?:R": "ask scale resolution",
    "?:S": "ask driver division",
    "?:SLEEP": "ask sleep",
    "?:SN": "ask serial number",
    "?:T": "ask trigger output",
    "?:V": "ask firmware",
    "?:W": "ask settling time",
    "?:WI": "ask input wait",
    "?:WT": "ask timer",
    "HRT:": "return to origin",
    "I:": "ask inputs",
    "A:": "set absolute target",
    "AP:": "set absolute target, prebuffer",
    "B:": "set speeds of origin return",
    "BEC:": "clear errors",
    "C:": "switch excitation",
    "D:": "set speeds",
    "DS:": "set start speed",
    "DF:": "set top speed",
    "DR:": "set ramp time",
    "E:": "set arc",
    "EP:": "set arc, prebuffer",
    "F:": "set loop",
    "G:": "go",
    "GC:": "go, continuous",
    "H:": "return to origin",
    "J:": "jog",
    "JD:": "set jog speed",
    "K:": "set line",
    "KP:": "set line, prebuffer",
    "L:": "stop by ramp",
    "L:E": "stop at once",
    "M:": "set relative amount",
    "MODE:": "select mode",
    "MP:": "set relative amount, prebuffer",
    "MS:": "memory switch",
    "O:": "set outputs",
    "P:": "program",
    "PSET:": "set coordinates",
    "R:": "set origin",
    "RC:": "set origin of the scale",
    "RESET:": "restart",
    "S:": "set driver division",
    "T:": "trigger output",
    "W:": "set settling time",
    "WI:": "wait for inputs",
    "WT:": "wait for timer",
}
_LONGEST = max(map(len, _WORDS))
_STATES = {"R": "ready", "B": "busy", "D": "not controllable"}


class Shrc203Decoder(TextDecoder):
    """Lines in both directions; each command has one reply."""

    def __init__(self) -> None:
        super().__init__()
        self._pending = PendingCommands()

    def describe_sent(self, line: str) -> DecodedFrame:
        self._pending.note_sent(line)
        return DecodedFrame(line, find_words(line, _WORDS, _LONGEST))

    def describe_received(self, line: str) -> DecodedFrame:
        command = self._pending.take_answered()
        if line in REFUSALS:
            return DecodedFrame(line, f"{command} is refused" if command else "refused")
        if line in ("OK", "OK_D"):
            return DecodedFrame(line, f"{command} is accepted" if command else "accepted")
        plain = line.replace(" ", "")
        if STATUS.matches_line(plain):
            axes = parse_status(plain, (1, 2, 3)[: (plain.count(",") + 1) // 3])
            return DecodedFrame(line, ", ".join(f"{n} at {s.counts} {_STATES[s.state]}" for n, s in axes.items()))
        return DecodedFrame(line, f"answer to {command}" if command else "answer")
