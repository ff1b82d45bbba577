"""Complete example programs of the SMC-4000's manual: downloaded, run, and compared with the manual.

They run on the serial port, where the messages of programs go (L3556). Garbled print is written as meant: straight
quotes, `TC1` for `TCI`, `WT` for `WI`, `*` for the printed sign.
"""

from dataclasses import dataclass, field
from typing import Any

import pytest

from sim.core.vectors import run_vector
from sim.yaskawa import SMC4000

REST: dict[str, Any] = {"until": "rest"}


@dataclass(frozen=True)
class Example:
    """A program of the manual (`place`: its lines), and a vector's `expect`.

    before, after: commands and steps before and after the download.
    burned: with BP and BN.
    """

    place: str
    program: str
    expect: dict[str, Any]
    before: tuple[str, ...] = ("SH",)
    options: dict[str, Any] = field(default_factory=dict[str, Any])
    given: dict[str, Any] = field(default_factory=dict[str, Any])
    after: tuple[dict[str, Any], ...] = ()
    send: str = "XQ\r"
    burned: bool = False

    def vector(self) -> dict[str, Any]:
        text = "\r".join(line.strip() for line in self.program.strip().splitlines())
        setup: list[dict[str, Any]] = [{"send": f"{command}\r"} for command in self.before]
        setup.append({"send": f"DL\r{text}\r\x1a"})
        setup += self.after
        if self.burned:
            setup += [{"send": "BP\r"}, {"send": "BN\r"}]
        return {
            "id": f"smc4000-program-{self.place}",
            "lines": self.place,
            "options": {"link": "serial", "echo": False, **self.options},
            "given": self.given,
            "setup": setup,
            "send": self.send,
            "expect": self.expect,
        }


def _told(query: str, *values: float) -> dict[str, Any]:
    return {"send": f"{query}\r", "reply": ",".join(map(str, values)) + "\r\n:", "reply_like": "numeric"}


def _value(name: str, value: float) -> dict[str, Any]:
    return _told(f"MG {name}", value)


EXAMPLES = [
    Example(
        "L2235-L2251",
        """#A
        JG 20000
        BGX
        WT 5000
        AB1
        WT 5000
        SH
        JP #A
        EN""",
        {
            "steps": [
                {"wait_s": 3.0},
                _value("_BGX", 1),
                {"wait_s": 3.0},
                _value("_BGX", 0),
                _told("SCX", 7),
                {"wait_s": 5.0},
                _value("_BGX", 1),
            ]
        },
    ),
    Example(
        "L2425-L2436",
        """#A;DP0
        PR 10000
        BG
        AD 5000
        MG "Halfway" ;TP
        EN""",
        {"reply_like": "blanks", "quiet_s": 2.0, "steps": [_told("RPX", 10000)]},
    ),
    Example(
        "L2648-L2658",
        """#F;DP 0
        PR 5000
        BG
        AM
        MG "DONE";TPX
        EN""",
        {"reply": ":DONE\r\n 0000005000\r\n", "reply_like": "numeric", "quiet_s": 2.0, "rest_position": {"X": 5000}},
    ),
    Example(
        "L2758-L2774",
        """#TEST
        DP0
        JG 1000
        BG
        AP 2000
        V1=_TP
        MG "Position is", V1
        ST
        EN""",
        {"quiet_s": 3.0, "steps": [REST, _value("(V1>1997)&(V1<2003)", 1)]},
        before=("SHX",),
    ),
    Example(
        "L2963-L2973",
        """#T;T0=TIME
        AT 0
        AT 50
        AT 100
        AT -150
        AT 80
        T1=TIME-T0;EN""",
        {"steps": [REST, _value("T1", 230)]},
    ),
    Example(
        "L3045-L3063",
        """#MOVE;DP 0,0
        CAT
        LMAB
        LI 1000,2000
        LI 2000,3000
        LE
        BGT
        AV ,500
        MG "Path>500";TPAB
        EN""",
        {"quiet_s": 2.0, "rest_position": {"X": 3000, "Y": 5000}, "steps": [REST, _value("_AVT>5800", 1)]},
    ),
    Example(
        "L4564-L4584",
        """#START
        PR 2000
        BG
        SLKJ
        EN
        #CMDERR
        V=_ED
        MG "An error has occurred" {N}
        MG "In line", V{F3.0}
        ST
        ZS0
        EN""",
        {"reply": ":An error has occurredIn line 003\r\n", "reply_like": "blanks", "quiet_s": 1.0},
        before=("SHX",),
    ),
    Example(
        "L5474-L5487",
        """#GEAR
        GA ,A,T
        GR ,.5,-2.5
        JG 5000
        BGA
        WT 10000
        STA
        EN""",
        {"steps": [REST, _value("(_RPX>48000)&(@ABS[_RPX-(_RPY*2)]<4)", 1), _told("RPZ", 0)]},
    ),
    Example(
        "L5266-L5278",
        """#HOME
        JG 500
        FI
        BGX
        AMX
        MG "FOUND INDEX"
        EN""",
        {
            "reply": ":FOUND INDEX\r\n",
            "reply_like": "blanks",
            "quiet_s": 8.0,
            "steps": [_told("RPX", 0), _told("SCX", 10)],
        },
        options={"index_every": {"X": 3000}},
    ),
    Example(
        "L7183-L7195",
        """#L;ALX
        LTX=25000
        PRX=100000
        BGX
        AMX
        JP #NOMRK,_SCX=1
        MG "MARK";EN
        #NOMRK;MG "NO MARK";EN""",
        {"reply": ":NO MARK\r\n", "reply_like": "blanks", "quiet_s": 8.0, "rest_position": {"X": 100000}},
    ),
    Example(
        "L9308-L9325",
        """#RECORD
        DM Torque[1000]
        RA Torque[]
        RD _TT
        RC 2
        JG 1000;BGX
        #A;JP #A,_RC=1
        MG "DONE RECORDING"
        EN""",
        {"reply": ":DONE RECORDING\r\n", "reply_like": "blanks", "quiet_s": 6.0, "steps": [_value("_RD", 0)]},
    ),
    Example(
        "L9539-L9550",
        """#W;JG 5000
        BGX
        ALX
        #WAIT;  JP #WAIT,_ALX=1
        RLX;STX
        EN""",
        {"steps": [{"wait_s": 1.8}, {"inputs": {"1": False}}, REST, _value("@RND[_RLX/1000]", 10)]},
    ),
    Example(
        "L11918-L11936",
        """#M;II1
        #A;JP #A;EN
        #ININT
        MG "INTERRUPT"
        S=_ZS
        S=
        ZS
        S=_ZS
        S=
        EN""",
        {"steps": [{"wait_s": 0.1}, {"inputs": {"1": False}}, {"wait_s": 0.1}, _value("S", 0), _value("_HX0", 0)]},
    ),
    Example(
        "L13067-L13086",
        """#ALT
        DP 0,0
        LMX
        LI 4000 <4000 >1000
        LI 1000 < 4000 >1000
        LE
        BGS
        EN""",
        {"rest_position": {"X": 5000}, "steps": [REST, _told("SCX", 101)]},
    ),
    Example(
        "L13226-L13270",
        """#LOAD
        DM VA[750],VB[750]
        count=0
        n=200
        #LOOP
        VA[count]=n
        VB[count]=n
        n=n+10
        count=count+1
        JP #LOOP, count<750
        #A
        LM XY;VS 100000;VA 1000000;VD 1000000
        count=0
        #LOOP2;JP#LOOP2,_LM=0
        JS#C, count=500
        LI VA[count],VB[count]
        count=count+1
        JP #LOOP2, count<750
        LE
        AMS
        MG "DONE"
        EN
        #C;BGS;EN""",
        {"steps": [REST, _value("count", 750), _told("RPXY", 2958750, 2958750)]},
    ),
    Example(
        "L13437-L13467",
        """#EXAMPLE
        VM ABC
        TN 2000/360,-500
        CR 3000,0,180
        VE
        CB1
        PA 3000,0,_TN
        BG ABC
        AM ABC
        SB1
        WT50
        BGS
        AMS
        CB1
        MG "ALL DONE"
        EN""",
        {
            "reply": ":ALL DONE\r\n",
            "reply_like": "blanks",
            "quiet_s": 4.0,
            "rest_position": {"X": -3000, "Y": 0, "Z": 1000},
            "tolerance": 8,
        },
    ),
    Example(
        "L13802-L13885",
        """#SETUP
        EAX
        EM 2000,1000
        EP 20,0
        N=0
        #LOOP
        P=N*3.6
        S=@SIN[P]*100
        SLAVE=N*10+S
        ET [N]=,SLAVE
        N=N+1
        JP #LOOP,N<=100
        #RUN
        EB1
        PA,500
        SP,5000
        BGY
        AM
        AI1
        EG,1000
        AI -1
        EQ,1000
        EN""",
        {
            "steps": [
                {"wait_s": 1.0},
                _told("RPY", 500),
                {"inputs": {"1": True}},
                {"send": "JGX=1000\r"},
                {"send": "BGX\r"},
                {"wait_s": 0.3},
                _value("_EGY", 0),
                {"wait_s": 1.0},
                _value("_EGY", 1),
                {"inputs": {"1": False}},
                {"wait_s": 2.0},
                _value("_EGY", 0),
                _value("@RND[_RPY/10]", 50),
            ]
        },
        given={"inputs": {"1": False}},
    ),
    Example(
        "L14342-L14354",
        """#AUTO
        SH
        PR 10000,20000;BG XY
        AM
        WT 2000
        JP # AUTO
        EN""",
        {"after_s": 2.0, "position": {"X": 10000, "Y": 20000}},
        before=(),
        send="RS\r",
        burned=True,
    ),
    Example(
        "L14388-L14423",
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
                _value("@OUT[1]", 1),
                {"inputs": {"2": False}},
                REST,
                _value("@FRAC[_RPX/1000]", 0),
                _value("_HX0+_HX1", 0),
            ]
        },
        send="XQ #TASK2,0\r",
    ),
    Example(
        "L14945-L14950",
        """#TWOMOVE
        PR 2000
        BGX
        PR 4000
        BGX
        EN""",
        {"reply": ":?003 PR 4000\r\n", "reply_like": "blanks", "steps": [REST, _told("RPX", 2000), _value("_ED", 3)]},
    ),
    Example(
        "L14990-L15002",
        """#SETBIT
        SP 10000
        PA 20000
        BGX
        AD 1000
        SB1
        EN""",
        {"steps": [REST, _value("@OUT[1]", 1), _told("RPX", 20000)]},
    ),
    Example(
        "L15004-L15028",
        """#TRIP
        JG 50000
        BGX;N=0
        DM P[5]
        #REPEAT
        AR 10000
        P[N]=_TPX
        SB1
        WT50
        CB1
        N=N+1
        JP #REPEAT,N<5
        STX
        EN""",
        {"steps": [REST, _value("@RND[(P[4]-P[0])/100]", 400), _value("N", 5)]},
    ),
    Example(
        "L15051-L15063",
        """#ATSPEED
        JG 50000
        AC 10000
        BGX
        ASX
        SB1
        EN""",
        {"steps": [{"wait_s": 4.5}, _value("@OUT[1]", 0), {"wait_s": 0.6}, _value("@OUT[1]", 1), _told("TVX", 50000)]},
    ),
    Example(
        "L15222-L15248",
        """#BEGIN
        COUNT=10
        #LOOP
        PA 1000
        BGX
        AMX
        WT 100
        PA 0
        BGX
        AMX
        WT 100
        COUNT=COUNT-1
        JP #LOOP,COUNT>0
        EN""",
        {"rest_position": {"X": 0}, "duration_s": 4.38, "tolerance_s": 0.1, "steps": [REST, _value("COUNT", 0)]},
    ),
    Example(
        "L15381-L15421",
        """#TEST
        II,,3
        MG "WAITING FOR INPUT 1, INPUT 2"
        #LOOP
        JP #LOOP
        EN
        #ININT
        IF (@IN[1]=0)
        IF (@IN[2]=0)
        V=12
        ELSE
        V=1
        ENDIF
        ELSE
        V=2
        ENDIF
        #WAIT
        JP#WAIT,(@IN[1]=0) | (@IN[2]=0)
        RI0""",
        {
            "reply": ":WAITING FOR INPUT 1, INPUT 2\r\n",
            "reply_like": "blanks",
            "steps": [
                {"inputs": {"2": False}},
                {"wait_s": 0.1},
                _value("V", 2),
                {"inputs": {"2": True}},
                {"wait_s": 0.1},
                {"inputs": {"1": False}},
                {"wait_s": 0.1},
                _value("V", 1),
            ],
        },
    ),
    Example(
        "L15448-L15472",
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
        {"rest_position": {"X": 1000, "Y": 1000}, "steps": [REST, _value("@OUT[1]", 0)]},
    ),
    Example(
        "L15516-L15530",
        """#LOOP
        JP #LOOP;EN
        #LIMSWI
        MG "LIMIT OCCURRED"
        N=N+1
        RE""",
        {
            "steps": [
                {"send": "N=0\r"},
                {"send": "JG 5000\r", "reply": ":"},
                {"send": "BGX\r", "reply": ":"},
                {"wait_s": 1.0},
                _value("N", 0),
                {"limits": {"X": "forward"}},
                {"wait_s": 0.1},
                {"send": "HX\r"},
                _value("N>1", 1),
                _told("SCX", 2),
            ]
        },
        before=("SHX", "N=0"),
        send="XQ #LOOP\r",
    ),
    Example(
        "L15532-L15561",
        """#LOOP
        JP #LOOP;EN
        #POSERR
        V1=_TEX
        MG "EXCESS POSITION ERROR"
        MG "ERROR=",V1=
        RE""",
        {
            "steps": [
                {"send": "JG 100000\r"},
                {"send": "BGX\r"},
                {"wait_s": 1.0},
                {"send": "HX\r"},
                {"send": "STX\r"},
                _value("V1>16384", 1),
            ]
        },
        given={"stalled": ["X"]},
        send="XQ #LOOP\r",
    ),
    Example(
        "L15563-L15581",
        """#A
        II1
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
                {"wait_s": 0.5},
                {"inputs": {"1": False}},
                {"wait_s": 0.5},
                _value("_BGX+_BGW", 0),
                _value("_HX0>0", 1),
                {"inputs": {"1": True}},
                {"wait_s": 0.5},
                _value("_BGX+_BGW", 2),
            ]
        },
    ),
    Example(
        "L15587-L15613",
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
            "reply_like": "blanks",
            "steps": [
                {"send": "13000000\r", "reply": "SPEED TOO HIGH\r\nTRY AGAIN\r\nENTER SPEED", "reply_like": "blanks"},
                {"send": "5000\r", "reply": "ENTER SPEED", "reply_like": "blanks"},
            ],
        },
    ),
    Example(
        "L15957-L15973",
        """#A
        COUNT=0;DM POS[10]
        #LOOP
        WT 10
        POS[COUNT]=_TPX
        POS[COUNT]=
        COUNT=COUNT+1
        JP #LOOP,COUNT<10
        EN""",
        {"reply": ":" + " 0000000000.0000\r\n" * 10, "reply_like": "numeric", "steps": [_value("COUNT", 10)]},
    ),
    Example(
        "L16031-L16050",
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
            "reply_like": "blanks",
            "quiet_s": 2.0,
            "steps": [_told("XPOS[299]=", 10000), _value("(YPOS[200]>8000)&(YPOS[200]<10000)", 1)],
        },
    ),
    Example(
        "L16118-L16126",
        """#A
        JG 50000;BGX;ASX
        WT 300
        MG "The Speed is", _TVX {F5.1} {N}
        MG "counts/sec"
        EN""",
        {"reply": ":The Speed is 50000.0counts/sec\r\n", "reply_like": "blanks", "quiet_s": 1.0},
    ),
    Example(
        "L16495-L16511",
        """#HOME
        AC 1000000
        DC 1000000
        SP 5000
        HM X
        BG X
        AM X
        MG "AT HOME"
        EN""",
        {
            "reply": ":AT HOME\r\n",
            "reply_like": "blanks",
            "quiet_s": 8.0,
            "steps": [_told("TPX", 0), _told("SCX", 10)],
        },
        options={"home_edge": {"X": -2000}, "index_every": {"X": 1000}},
    ),
    Example(
        "L16513-L16531",
        """#EDGE
        AC 2000000
        DC 2000000
        SP 8000
        FE Y
        BG Y
        AM Y
        MG "FOUND HOME"
        DP,0
        EN""",
        {
            "reply": ":FOUND HOME\r\n",
            "reply_like": "blanks",
            "quiet_s": 2.0,
            "steps": [_told("SCY", 9), _told("TPY", 0)],
        },
        options={"home_edge": {"Y": -2000}},
    ),
    Example(
        "L16719-L16737",
        """#POINTS
        SP 7000
        AC 80000;DC 80000
        N=0
        #LOOP
        COMPP=N*1000
        PA COMPP
        BGX
        AMX
        N=N+1
        JP #LOOP,N<4
        EN""",
        {"rest_position": {"X": 3000}},
    ),
    Example(
        "L16812-L16840",
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
        "L16884-L16955",
        """#POINTS
        DM POS[16]
        DM DIF[15]
        C=0
        T=0
        #A
        V1=50*T
        V2=3*T
        V3=-955*@SIN[V2]+V1
        V4=@INT[V3]
        POS[C]=V4
        T=T+8
        C=C+1
        JP #A,C<16
        #B
        C=0
        #C
        D=C+1
        DIF[C]=POS[D]-POS[C]
        C=C+1
        JP #C,C<15
        EN
        #RUN
        CMX
        DT3
        C=0
        #E
        CD DIF[C]
        WC
        C=C+1
        JP #E, C<15
        DT0
        CD0
        EN""",
        {
            "displacement": {"X": 6000},
            "duration_s": 0.117,
            "tolerance_s": 0.005,
            "steps": [REST, _value("POS[15]", 6000)],
        },
        after=({"send": "XQ\r"}, REST),
        send="XQ #RUN\r",
    ),
    Example(
        "L16983-L17007",
        """#LMOVE
        DP 0,0
        LMX
        LI 5000
        LE
        VS 4000
        BGS
        AV 4000
        VS 1000
        T=TIME
        AMS
        T=TIME-T
        EN""",
        {"rest_position": {"X": 5000}, "steps": [REST, _value("(T>1000)&(T<1100)", 1)]},
    ),
    Example(
        "L17105-L17122",
        """#A
        PR 2000,100
        SP 15000,5000
        AC 500000,500000
        DC 500000,500000
        BG X
        WT 40
        BG Y
        EN""",
        {"rest_position": {"X": 2000, "Y": 100}, "duration_s": 0.1633, "tolerance_s": 0.004},
    ),
    Example(
        "L17156-L17164",
        """#S;JG 4000
        AI 1;BGX
        AI -1;STX
        AMX;JP #S
        EN;""",
        {
            "steps": [
                {"wait_s": 1.0},
                _value("_BGX", 1),
                {"inputs": {"1": False}},
                {"wait_s": 1.0},
                _value("_BGX", 0),
            ]
        },
    ),
    Example(
        "L17166-L17198",
        """#A
        II 1
        JG 30000,-20000
        BG XY
        #B
        WT 1000
        JP #B
        EN
        #ININT
        MG "Interrupt has occurred"
        ST XY
        #LOOP;JP #LOOP,@IN[1]=0
        JG 15000,10000
        WT 300
        BG XY
        RI""",
        {
            "steps": [
                {"wait_s": 0.5},
                {"inputs": {"1": False}},
                {"wait_s": 1.0},
                _value("_BGX+_BGY", 0),
                {"inputs": {"1": True}},
                {"wait_s": 1.0},
                _told("TVXY", 15000, 10000),
            ]
        },
    ),
    Example(
        "L17225-L17259",
        """#AUTO
        ERX=150; OEX=1; II3
        SHX; WT 500
        #BUSY
        JGX=3000
        BGX
        #LP;WT500
        JP#LP
        EN
        #POSERR
        SB1
        AI1; AI-1
        CB1; SHX; WT 500
        RE1""",
        {
            "steps": [
                {"wait_s": 1.0},
                _value("_BGX", 1),
                {"stalled": ["X"]},
                {"wait_s": 1.0},
                _value("_MOX", 1),
                _value("@OUT[1]", 1),
                _told("SCX", 8),
                {"inputs": {"1": False}},
                {"wait_s": 0.1},
                _value("_MOX", 0),
                _value("@OUT[1]", 0),
            ]
        },
        before=(),
        send="RS\r",
        burned=True,
    ),
    Example(
        "L17280-L17294",
        """#A;JG 5000;BGX
        WT 100
        SP 13000000
        EN
        #CMDERR
        JP#LIMSWI,_TC=22
        AB1
        MG "Error"{N};TC1
        MG "on line",_ED{F3.0}
        MG "Program halted!"
        AB
        EN
        #LIMSWI;EN""",
        {
            "reply": ":Error6 Number out of range\r\non line 002\r\nProgram halted!\r\n",
            "reply_like": "blanks",
            "quiet_s": 1.0,
            "steps": [_value("_BGX", 0), _told("SCX", 7), _value("_HX0", 0)],
        },
    ),
    Example(
        "L17306-L17332",
        """#A;FLX=2000;JGX=5000;BGX
        #W;JP #W
        #LIMSWI;WT 10
        Limit="+"
        Axis="X"; JS #HARD,_LFX=0; JS#SOFT,_FLX<_TPX
        AB1; HX1; HX2; HX3
        ZS
        MG "PROGRAM HALTED! (LIMSWI)"
        EN
        #HARD;MG Limit {S1},Axis{S1},"HARDWARE LIMIT HIT!";EN
        #SOFT;MG Limit {S1},Axis{S1},"SOFTWARE LIMIT HIT!";EN""",
        {
            "reply": ":+XSOFTWARE LIMIT HIT!\r\nPROGRAM HALTED! (LIMSWI)\r\n",
            "reply_like": "blanks",
            "quiet_s": 1.0,
            "steps": [_value("_HX0", 0), _value("_BGX", 0)],
        },
    ),
    Example(
        "L17345-L17371",
        """#A;II3
        #BUSY;SB1;WT 20;CB1;WT 20;JP #BUSY
        #ININT
        AB1; HX1; HX2; HX3
        SB3
        AI-3; AI3
        CB3
        SHX
        WT2000
        ZS
        II3
        JP #BUSY
        EN""",
        {
            "steps": [
                {"wait_s": 0.2},
                {"inputs": {"3": False}},
                {"wait_s": 0.2},
                _value("@OUT[3]", 1),
                {"inputs": {"3": True}},
                {"wait_s": 2.5},
                _value("@OUT[3]", 0),
                _value("_HX0>0", 1),
                _value("_ZS0", 0),
                {"inputs": {"3": False}},
                {"wait_s": 0.1},
                _value("@OUT[3]", 1),
            ]
        },
    ),
    Example(
        "L17394-L17416",
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
            "steps": [
                {"wait_s": 0.5},
                {"inputs": {"1": True}},
                {"wait_s": 0.1},
                {"inputs": {"1": False}},
                {"wait_s": 1.923},
                _value("@OUT[1]", 1),
                {"wait_s": 0.05},
                _value("@OUT[1]", 0),
                _told("RPX", 6370),
            ]
        },
        given={"inputs": {"1": False}},
    ),
    Example(
        "L17549-L17579",
        """#A
        DP0
        LINPOS=0
        PR 1000
        BGX
        #B
        AMX
        WT 50
        LINPOS = _DEX
        ER=1000-LINPOS-_TEX
        JP #C,@ABS[ER]<2
        PR ER
        BGX
        DEX=1000
        JP #B
        #C
        EN""",
        {"rest_position": {"X": 1020}, "steps": [REST, _value("LINPOS", 1000)]},
        before=("SHX", "DEX=980"),
    ),
    Example(
        "L7386-L7393",
        """#MOVE
        TWX=100
        PR2000
        BGX
        MCX
        WT 10
        EN
        #MCTIME
        MG "NOT IN POSITION"
        RE""",
        {"reply": ":NOT IN POSITION\r\n", "reply_like": "blanks", "quiet_s": 2.0, "steps": [_told("SCX", 99)]},
        before=("SHX", "ERX=0"),
        given={"stalled": ["X"]},
    ),
]


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.place)
def test_a_program_of_the_manual_runs_as_documented(example: Example):
    failures = run_vector(SMC4000, example.vector())
    assert not failures, "\n".join(f"{each.sent!r}: {each.expected} / {each.received}" for each in failures)
