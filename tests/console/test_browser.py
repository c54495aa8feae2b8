"""The console in the system's chromium: controls, measurement, recording, two browsers, no request to elsewhere."""

import json
import os
import re
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from ringpose.cli.main import main

pytestmark = pytest.mark.slow

EXAMPLES = Path(__file__).parents[2] / "examples"
WAIT_MS = 60_000


@pytest.fixture(scope="module")
def chromium():
    """A browser; in CI a missing one is a failure."""
    path = shutil.which("chromium")
    if path is None:
        what = "chromium is not installed (apt install chromium)"
        pytest.fail(what) if os.environ.get("CI") else pytest.skip(what)
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def console(tmp_path_factory):
    """Address of a console, and the folder in which it records."""
    folder = tmp_path_factory.mktemp("console")
    for name in ("scene.yaml", "scene-rig.yaml"):
        shutil.copy(EXAMPLES / name, folder)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    program = [Path(sys.executable).parent / "ringpose", "simulate", "console", "scene.yaml", "--port", str(port)]
    words = [*program, "--output", "recorded"]
    with subprocess.Popen(words, cwd=folder, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        yield json.loads(process.stdout.readline())["page"], folder
        process.terminate()
        assert process.wait(30) == 143


@pytest.fixture
def page(chromium, console):
    """A page with its first measurement, and the addresses that it requested."""
    context = chromium.new_context(viewport={"width": 1024, "height": 800})
    opened = context.new_page()
    opened.requested = []
    opened.on("request", lambda request: opened.requested.append(request.url))
    opened.on("websocket", lambda websocket: opened.requested.append(websocket.url))
    opened.goto(console[0])
    opened.wait_for_selector("text=errors: centre", timeout=WAIT_MS)
    yield opened
    context.close()


def state_number(page):
    return int(re.search(r"\(state (\d+),", page.inner_text("body"))[1])


def number_field(page, label):
    row = page.locator("label", has_text=label).locator("xpath=ancestor::div[contains(@class, 'Flex-root')][1]")
    return row.locator("input[type=text]")


def picture_of(page):
    """The live image, as bytes of the address that viser gives it."""
    source = page.locator("img[src^='blob:']").first.get_attribute("src")
    return page.evaluate("async url => Array.from(new Uint8Array(await (await fetch(url)).arrayBuffer()))", source)


def wait_for_newer_state(page, number):
    page.wait_for_function(
        "number => +(document.body.innerText.match(/\\(state (\\d+),/) || [0, -1])[1] > number",
        arg=number,
        timeout=WAIT_MS,
    )


def errors_in(page):
    return dict(
        re.findall(
            r"(centre|grasp|normal) ([\d.]+) (?:mm|deg)",
            re.search(r"errors: .*", page.inner_text("body"), re.DOTALL)[0],
        )
    )


def test_nothing_is_requested_from_elsewhere(page):
    assert page.requested
    foreign = [url for url in page.requested if not re.match(r"(http|ws|blob:http)://127\.0\.0\.1[:/]|data:", url)]
    assert foreign == []


def test_a_control_moves_the_target_and_a_laser_switch_changes_the_image(page):
    before, number = picture_of(page), state_number(page)
    field = number_field(page, "centre x (m)")
    field.fill(str(round(float(field.input_value()) + 0.01, 3)))
    field.press("Enter")
    wait_for_newer_state(page, number)
    moved, number = picture_of(page), state_number(page)
    assert moved != before

    page.get_by_label("laser middle").click()
    wait_for_newer_state(page, number)
    assert picture_of(page) != moved
    number = state_number(page)
    page.get_by_label("laser middle").click()
    wait_for_newer_state(page, number)


def test_recorded_shots_are_measured_by_pose_with_the_errors_that_the_page_shows(page, console, capsys):
    recorded = console[1] / "recorded"
    number = state_number(page)
    page.get_by_label("record shots with their truth").click()
    field = number_field(page, "pitch (deg)")
    field.fill(str(round(float(field.input_value()) + 1.0, 1)))
    field.press("Enter")
    wait_for_newer_state(page, number)
    page.get_by_label("record shots with their truth").click()
    shot = sorted((recorded / "shots").glob("*.npz"))[-1]
    assert int(shot.stem.rpartition("_")[2]) == state_number(page)
    shown = errors_in(page)

    assert main(["pose", str(shot), "--rig", str(recorded / "rig.yaml")]) == 0
    poses = console[1] / "poses.jsonl"
    poses.write_text(capsys.readouterr().out)
    words = ["--truth", str(recorded / "truth.jsonl"), "--rig", str(recorded / "rig.yaml"), "--json", "-"]
    main(["bench", str(poses), *words])
    scored = next(each for each in json.loads(capsys.readouterr().out)["shots"] if each["shot"] == shot.stem)
    assert float(shown["grasp"]) == pytest.approx(1e3 * scored["errors"]["grasp_m"], abs=6e-4)
    assert float(shown["centre"]) == pytest.approx(1e3 * scored["errors"]["center_m"], abs=6e-4)


def test_two_browsers_and_a_reload_show_the_same_state(page, console, chromium):
    number = state_number(page)
    field = number_field(page, "yaw (deg)")
    value = str(round(float(field.input_value()) + 0.5, 1))
    field.fill(value)
    field.press("Enter")
    wait_for_newer_state(page, number)
    other = chromium.new_page()
    other.goto(console[0])
    other.wait_for_selector("text=errors: centre", timeout=WAIT_MS)
    assert number_field(other, "yaw (deg)").input_value() == value
    other.close()
    page.reload()
    page.wait_for_selector("text=errors: centre", timeout=WAIT_MS)
    assert number_field(page, "yaw (deg)").input_value() == value


@pytest.mark.parametrize("width", [1024, 2560])
def test_image_and_controls_are_in_view(page, width):
    page.set_viewport_size({"width": width, "height": 900})
    box = page.locator("img[src^='blob:']").first.bounding_box()
    assert box is not None
    assert box["width"] > 250
    assert 0 <= box["x"] <= width - box["width"]
