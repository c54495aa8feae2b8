"""The commands write the lines that they wrote when these were last looked at (`make golden` renews them)."""

import copy

import golden_lines
import pytest

CARRIED = [name for name in golden_lines.STREAMS if name.startswith("carried")]


def assert_unchanged(name: str) -> None:
    found = list(golden_lines.changes(golden_lines.read_lines(name), golden_lines.STREAMS[name]()))

    assert not found, f"{name}: {len(found)} lines have changed; see `make golden`\n" + "\n".join(found)


@pytest.mark.parametrize("name", CARRIED)
def test_lines_of_carried_shots_are_the_golden_ones(name):
    assert_unchanged(name)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in golden_lines.STREAMS if name not in CARRIED])
def test_lines_of_rendered_shots_are_the_golden_ones(name, shared_data):
    assert_unchanged(name)


def test_there_are_golden_lines_of_every_rendered_shot(shared_data):
    rendered = [path.stem for name in golden_lines.SETS for path in (shared_data / "rendered" / name).glob("shots/*")]

    golden = [record["shot"] for name in golden_lines.SETS for record in golden_lines.read_lines(name)]

    assert sorted(golden) == sorted(rendered)


def changed(*path: str | int, by: float) -> list[str]:
    """The differences of a golden line from one of which a number is changed by so many of its standard deviations."""
    (record,) = (each for each in golden_lines.read_lines("carried") if each["shot"] == "B_z0500_p00_dim")
    now = copy.deepcopy(record)
    *parents, key = path
    place = now
    for name in parents:
        place = place[name]
    sd = golden_lines.deviations(record)[".".join(map(str, path[:2]))][path[2]]
    place[key] += by * sd
    return golden_lines.differences(record, now)


def test_a_number_may_differ_by_a_millionth_of_its_standard_deviation_and_no_more():
    assert not changed("pose", "center_m", 0, by=0.5e-6)
    assert "pose.center_m" in changed("pose", "center_m", 0, by=2e-6)[0]


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("status", "degraded"),
        ("flags", ["center_weak"]),
        ("rejected", [{}]),
        ("reason", "x"),
        ("new", 1),
    ],
)
def test_what_is_not_a_number_must_be_equal(key, value):
    (record, *_) = golden_lines.read_lines("carried")

    found = golden_lines.differences(record, {**record, key: value})

    assert len(found) == 1
    assert found[0].startswith(f"{key}: ")


def test_the_sign_of_a_row_does_not_matter_and_its_size_does():
    (record, *_) = golden_lines.read_lines("carried")
    turned, larger = copy.deepcopy(record), copy.deepcopy(record)
    turned["measurement"]["square_root"][0] = [-number for number in record["measurement"]["square_root"][0]]
    larger["measurement"]["square_root"][0] = [1.001 * number for number in record["measurement"]["square_root"][0]]

    assert not golden_lines.differences(record, turned)
    assert "measurement.square_root" in golden_lines.differences(record, larger)[0]


def test_lines_that_are_new_or_missing_are_named():
    (first, second, *_) = golden_lines.read_lines("carried")

    found = list(golden_lines.changes([first], [second]))

    assert found == [f"{first['shot']}: is missing", f"{second['shot']}: is new"]


def test_a_stored_line_does_not_differ_from_what_was_written():
    now = golden_lines.STREAMS["carried_track"]()

    assert not list(golden_lines.changes([golden_lines.stored(record) for record in now], now))
