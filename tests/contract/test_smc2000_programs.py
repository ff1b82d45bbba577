"""Complete example programs of the SMC-2000's manual: downloaded, run, and compared with the manual."""

from dataclasses import dataclass, field
from typing import Any

import pytest

from sim.core.vectors import run_vector
from sim.yaskawa import SMC2000


@dataclass(frozen=True)
class Example:
    """A program of the manual (`place`: its lines), how it is started, and a vector's `expect`."""

    place: str
    program: str
    expect: dict[str, Any]
    options: dict[str, Any] = field(default_factory=dict[str, Any])
    given: dict[str, Any] = field(default_factory=dict[str, Any])
    send: str = "XQ\r"

    def vector(self) -> dict[str, Any]:
        text = "\r".join(line.strip() for line in self.program.strip().splitlines())
        return {
            "id": f"smc2000-program-{self.place}",
            "lines": self.place,
            "options": {"echo": False, **self.options},
            "given": self.given,
            "setup": [{"send": f"DL\r{text}\r\\"}],
            "send": self.send,
            "expect": self.expect,
        }


def _told(query: str, *values: float) -> dict[str, Any]:
    return {"send": f"{query}\r", "reply": ",".join(map(str, values)) + "\r\n:", "reply_like": "numeric"}


REST: dict[str, Any] = {"until": "rest"}

EXAMPLES = [
    Example(
        "L513-L536",
        """#B;DP 0,0
        PR 30000,60000
        SP 5000,5000
        BGX
        AD 4000
        BGY
        AP 6000
        SP 2000,50000
        AP ,50000
        SP ,10000
        EN""",
        {"reply": ":", "rest_position": {"X": 30000, "Y": 60000}},
    ),
    Example(
        "L639-L652",
        """#A;VM XY
        VP -4000,0
        CR 2000,270,-180
        VP 0,4000
        CR 2000,90,-180
        VE
        BGS
        EN""",
        {"reply": ":", "steps": [REST, _told("RPXY", 0, 0), _told("SCX", 101)]},
    ),
    Example(
        "L3387-L3393",
        """#AUTO
        SH
        PR 10000,20000;BG XY
        AM
        WT 2000
        JP # AUTO
        EN""",
        {"after_s": 2.0, "position": {"X": 10000, "Y": 20000}},
    ),
    Example(
        "L3429-L3460",
        """#TASK1
        AT0
        CB1
        #LOOP1
        AT 10
        SB1
        AT -40
        CB1
        JP #LOOP1
        #TASK2
        XQ #TASK1,1
        #LOOP2
        PR 1000
        BGX
        AMX
        WT 10
        JP #LOOP2,@IN[2]=1
        HX""",
        {
            "steps": [
                {"wait_s": 0.02},
                _told("MG @OUT[1]", 1),
                {"inputs": {"2": False}},
                REST,
                _told("MG @FRAC[_RPX/1000]", 0),
                _told("MG _HX0+_HX1", 0),
            ],
        },
        send="XQ #TASK2,0\r",
    ),
    Example(
        "L3803-L3809",
        """#SETBIT
        SP 10000
        PA 20000
        BGX
        AD 1000
        SB1
        EN""",
        {"reply": ":", "steps": [{"wait_s": 0.1}, _told("MG @OUT[1]", 1)], "rest_position": {"X": 20000}},
    ),
    Example(
        "L3854-L3860",
        """#ATSPEED
        JG 50000
        AC 10000
        BGX
        ASX
        SB1
        EN""",
        {"steps": [{"wait_s": 5.0}, _told("MG @OUT[1]", 0), {"wait_s": 0.8}, _told("MG @OUT[1]", 1)]},
    ),
    Example(
        "L3873-L3880",
        """#VECTOR
        VMXY;VS 5000
        VP 10000,20000
        VP 20000,30000
        VE
        BGS
        AV 5000
        VS 1000
        EN""",
        {"reply": ":", "rest_position": {"X": 20000, "Y": 30000}, "duration_s": 32.484, "tolerance_s": 0.01},
    ),
    Example(
        "L4052-L4067",
        """#M
        CB1
        VP 1000,1000;LE;BGS;AMS
        SB1
        JS #SQUARE;CB1
        EN
        #SQUARE
        V1=500;JS #L
        V1=-V1;JS #L
        EN
        #L;PR V1,V1;BGX
        AMX;BGY;AMY
        EN""",
        {
            "reply": ":",
            "rest_position": {"X": 1000, "Y": 1000},
            "steps": [REST, _told("MG _XQ0", -1), _told("TC0", 0)],
            "outputs": {"1": False},
        },
    ),
    Example(
        "L4171-L4183",
        """#A
        II 1
        JG 30000,,,60000
        BGXW
        #LOOP;JP#LOOP;EN
        #ININT
        ST;AM
        #TEST;JP #TEST, @IN[1]=0
        BGXW;RI
        EN""",
        {
            "steps": [
                {"wait_s": 1.0},
                _told("MG _BGX+_BGW", 2),
                {"inputs": {"1": False}},
                {"wait_s": 1.0},
                _told("MG _BGX+_BGW", 0),
                {"inputs": {"1": True}},
                {"wait_s": 1.0},
                _told("MG _BGX+_BGW", 2),
            ]
        },
    ),
    Example(
        "L4191-L4224",
        """#BEGIN
        IN "ENTER SPEED", SPEED
        JG SPEED;BGX;
        JP #BEGIN
        EN
        #CMDERR
        JP#DONE,_TC<>6
        MG "SPEED TOO HIGH"
        MG "TRY AGAIN"
        ZS1
        JP #BEGIN
        #DONE
        ZS0
        EN""",
        {
            "reply": ":ENTER SPEED",
            "steps": [
                {"send": "9000000\r", "reply": "SPEED TOO HIGH\r\nTRY AGAIN\r\nENTER SPEED"},
                {"send": "5000\r", "reply": "ENTER SPEED"},
                {"send": "6000\r", "reply": ""},
                _told("MG _HX0", 0),
                _told("MG _JGX", 6000),
                _told("TC0", 21),
            ],
        },
    ),
    Example(
        "L4544-L4553",
        """#A
        COUNT=0;DM POS[10]
        #LOOP
        WT 10
        POS[COUNT]=_TPX
        POS[COUNT]=
        COUNT=COUNT+1
        JP #LOOP,COUNT<10
        EN""",
        {
            "reply": ":" + "".join(f"{100}.0000\r\n" for _ in range(10)),
            "reply_like": "numeric",
            "steps": [_told("COUNT=", 10), _told("POS[9]=", 100)],
        },
        given={"position": {"X": 100}},
    ),
    Example(
        "L4629-L4645",
        """#RECORD
        DM XPOS[300],YPOS[300]
        DM XERR[300],YERR[300]
        RA XPOS[],XERR[],YPOS[],YERR[]
        RD _TPX,_TEX,_TPY,_TEY
        PR 10000,20000
        RC1
        BG XY
        #A;JP #A,_RC=1
        MG "DONE"
        EN""",
        {
            "reply": ":DONE\r\n",
            "quiet_s": 2.0,
            "steps": [_told("XPOS[299]=", 10000), _told("MG @INT[XPOS[100]/100]*100", 3600), _told("XERR[50]=", 0)],
        },
    ),
    Example(
        "L4741-L4747",
        """#DISPLAY
        PR 1000
        BGX
        AMX
        V1=_TPX
        V1=
        EN""",
        {"reply": ":0000001000.0000\r\n", "reply_like": "numeric"},
    ),
    Example(
        "L4781-L4795",
        """#BEGIN
        AC 800000
        DC 800000
        SP 5000
        LEN=3.4
        #CUT
        AI1
        IN "enter Length(IN)", LEN
        PR LEN *4000
        BGX
        AMX
        SB1
        WT100;CB1
        JP #CUT
        EN""",
        {
            "reply": ":",
            "steps": [
                {"inputs": {"1": True}},
                {"wait_s": 0.1},
                {"inputs": {"1": False}},
                {"send": "2\r", "reply": ""},
                {"wait_s": 2.0},
                _told("RPX", 8000),
            ],
        },
        given={"inputs": {"1": False}},
    ),
    Example(
        "L5114-L5118",
        """#S;JG 4000
        AI 1;BGX
        AI -1;STX
        AMX;JP #S
        EN;""",
        {
            "steps": [
                {"wait_s": 1.0},
                _told("MG _BGX", 1),
                {"inputs": {"1": False}},
                {"wait_s": 1.0},
                _told("MG _BGX", 0),
            ]
        },
    ),
    Example(
        "L5194-L5203",
        """#POINTS
        SP 7000
        AC 80000;DC 80000
        #LOOP
        COMPP=@AN[1]*1000
        PA COMPP
        BGX
        AMX
        JP #LOOP
        EN""",
        {"after_s": 3.0, "position": {"X": 5000}},
        given={"analog": {"1": 5.0}},
    ),
    Example(
        "L5269-L5279",
        """#A
        AI1
        PR 6370
        SP 3185
        BGX
        AMX
        SB1
        WT 20
        CB1
        WT 80
        JP #A""",
        {
            "reply": ":",
            "steps": [
                {"inputs": {"1": True}},
                {"wait_s": 0.1},
                {"inputs": {"1": False}},
                {"wait_s": 3.0},
                _told("RPX", 6370),
                _told("MG _HX0", 2),
            ],
            "outputs": {"1": False},
        },
        given={"inputs": {"1": False}},
    ),
    Example(
        "L5336-L5375",
        """#A
        VM XY
        VP 160000,160000
        VE
        VS 200000
        VA 1544000
        BGS
        AMS
        PR,,-80000
        SP,,80000
        BGZ
        AMZ
        CR 80000,270,-360
        VE
        VS 40000
        BGS
        AMS
        PR,,80000
        BGZ
        AMZ
        PR -21600
        SP 20000
        BGX
        AMX
        EN""",
        {"reply": ":", "rest_position": {"X": 138400, "Y": 160000, "Z": 0}},
    ),
    Example(
        "L5426-L5434",
        """#A
        JG0
        BGX
        #B
        VIN=@AN[1]
        VEL=VIN*20000
        JG VEL
        JP #B
        EN""",
        {"after_s": 3.0, "velocity": {"X": 50000}},
        given={"analog": {"1": 2.5}},
    ),
    Example(
        "L7265-L7274",
        """#TEST
        DP0
        JG 1000
        BG X
        AP 2000
        V1=_TPX
        MG "Position is",V1=
        ST
        EN""",
        {"reply": ":Position is 0000002000.0000\r\n", "reply_like": "numeric", "quiet_s": 3.0},
    ),
    Example(
        "L12896-L12912",
        """#ABSOLUT
        XHmOfs=2344
        AEX=4096
        EN
        #CMDERR
        AB1; ZS
        MG "Error "{N};TC1{N}
        MG " on line",_ED{F3.0}
        MG "Program halted!"
        AB
        EN""",
        {"reply": ":Error 114 Absolute Encoder option not installed on line 002\r\nProgram halted!\r\n"},
    ),
]


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.place)
def test_programs_of_the_manual(example: Example) -> None:
    assert run_vector(SMC2000, example.vector()) == []
