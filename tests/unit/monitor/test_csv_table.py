"""Tables of text: no formulas, and the signs of other countries."""

import io
import math

from orchestrator.monitor.export.csv_table import USUAL_STYLE, CsvStyle, CsvTable


def write(*values: object, style: CsvStyle = USUAL_STYLE) -> str:
    text = io.StringIO()
    CsvTable(text, style, "\n").write_row(values)
    return text.getvalue()


def test_a_text_is_no_formula_and_a_number_is_one() -> None:
    assert write("=1+1", "@SUM(A1)", "+x", "-x", "\t=1", "plain") == "'=1+1,'@SUM(A1),'+x,'-x,'\t=1,plain\n"
    assert write(-1, -0.5, 10**20) == "-1,-0.5,100000000000000000000\n"


def test_what_is_no_value_is_an_empty_cell() -> None:
    assert write(None, math.nan, True, False) == ",,true,false\n"


def test_a_comma_as_decimal_sign() -> None:
    assert write("a;b", 1.5, 2, 1e-9, style=CsvStyle(";", ",")) == '"a;b";1,5;2;1e-09\n'
