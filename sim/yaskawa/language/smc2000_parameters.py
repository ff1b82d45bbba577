"""Parameters of axes of the SMC-2000; with its manual's line for each one that differs from the SMC-4000's."""

from sim.yaskawa.language.parameters import FINE, LARGEST, SMC4000, AxisParameter, make_parameter

_SAME = ("AC", "DC", "PR", "PA", "IT", "EM", "GR", "BL", "FL", "ER", "KI", "OE")

SMC2000: dict[str, AxisParameter] = {op: SMC4000[op] for op in _SAME} | {
    "AF": make_parameter(0, 1, 0, shape="1.0", moving=False),  # L7012
    "SP": make_parameter(0, 8000000, 25000, 2),  # L11548
    "JG": make_parameter(-8000000, 8000000, 25000, 2),  # L9556
    "KS": make_parameter(0.5, 16, 1, 0.5, "4.0"),  # L9795
    "LT": make_parameter(1, LARGEST, LARGEST, shape="10.0"),  # L10166
    "TW": make_parameter(-1, 32767, 32766),  # L12228
    "CE": make_parameter(0, 15, 0, shape="2.0"),  # L7786
    "DV": make_parameter(0, 1, 0, shape="1.0", asked=False),  # L8361
    "FA": make_parameter(0, 4097, 0, shape="4.0"),  # L8797
    "FV": make_parameter(0, 8191, 0, shape="3.0"),  # L8989
    "GN": make_parameter(0, 2047, 70, shape="4.0"),  # L9060
    "ZR": make_parameter(0, 1, 0.9143, 1 / 256, "1.4"),  # L12750, L12775
    "IL": make_parameter(-9.9988, 9.9988, 9.9988, FINE, "1.4"),  # L9320
    "KD": make_parameter(0, 4095.875, 64, 0.125, "4.2"),  # L9690
    "KP": make_parameter(0, 1023.875, 6, 0.125, "4.2"),  # L9763
    "MT": make_parameter(-2.5, 2.5, 1, 0.5, "1.1", moving=False),  # L10537
    "OF": make_parameter(-9.9988, 9.9988, 0, FINE, "1.4"),  # L10666
    "TL": make_parameter(0, 9.9988, 9.9988, FINE, "1.4"),  # L11976
    "AE": make_parameter(-100000, 100000, 0, asked=False, moving=False),  # L6970
}
