"""The table as the user sees it."""

from ringpose.bench.score import Outcome, Score
from ringpose.bench.summary import summaries
from ringpose.bench.table import table
from ringpose.types.table import WIDTH


def scores() -> list[Score]:
    near = {"center_m": 0.0123456, "normal_rad": 0.0174533, "grasp_m": 0.00012345, "center_nees": 1.25}
    return [
        Score(shot="a", method="paper", outcome=Outcome.OK, status="ok", groups={"distance_m": 0.5}, errors=near),
        Score(shot="b", method="paper", outcome=Outcome.MISSED, status="none", groups={"distance_m": 1}),
    ]


def test_every_line_of_a_block_has_its_numbers_in_columns():
    first, continued, *_ = table(summaries(scores(), ["distance_m"]), ["distance_m"]).split("\n\n")

    assert first.splitlines() == [
        "shots",
        "method  distance_m  shots  ok  degraded  missed  partial  part.none  no target",
        "paper   0.5             1   1         0       0        0          0          0",
        "paper   1               1   0         0       1        0          0          0",
        "paper   all             2   1         0       1        0          0          0",
    ]
    assert continued.splitlines()[::3] == ["method  distance_m  wrong  lost", "paper   all             0     0"]


def test_errors_have_three_digits_in_millimetres_and_degrees():
    text = table(summaries(scores(), []), [])
    rms, continued = text.split("errors, root mean square\n")[1].split("\n\n")[:2]

    assert rms.splitlines()[1].split() == ["paper", "-", "-", "-", "12.3", "1.00", "-", "-", "0.123"]
    assert continued.splitlines()[1].split() == ["paper", "1.25", "-"]


def test_a_table_fits_a_terminal_of_80_columns():
    text = table(summaries(scores(), ["distance_m"]), ["distance_m"])

    rows = [line for line in text.splitlines() if line.startswith(("method", "paper "))]
    assert len(rows) > 12
    assert max(map(len, rows)) <= WIDTH == 80


def test_without_a_quantity_that_could_be_wrong_nothing_is_judged():
    text = table(summaries(scores()[1:], []), [])

    assert "paper: nothing judged: 0 of 0 quantities are wrong" in text
    assert "none wrong" not in text
