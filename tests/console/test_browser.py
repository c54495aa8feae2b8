"""The console in the system's chromium: controls, measurement, recording, two browsers, no request to elsewhere."""

import json
import re
import shutil
import socket
import subprocess
import sys
import threading
from contextlib import contextmanager
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from needed import needed_module, needed_program

from ringpose.cli.main import main

pytestmark = pytest.mark.slow

EXAMPLES = Path(__file__).parents[2] / "examples"
WAIT_MS = 180_000
"""Software rendering in a busy machine takes long."""


@pytest.fixture(scope="module")
def chromium():
    path = needed_program("chromium", "chromium")
    playwright_api = needed_module("playwright.sync_api", "ringpose[dev]")

    with playwright_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield browser
        browser.close()


def test_a_replay_in_one_file_draws_its_scene_enlarges_pictures_and_requests_nothing(chromium, carried_data, tmp_path):
    data, file = carried_data / "rig_b", tmp_path / "replay.html"
    rig, shot, truth = (str(data / name) for name in ("rig.yaml", "shots/B_z0500_p01_dim.npz", "truth.jsonl"))
    assert main(["view", shot, "--rig", rig, "--truth", truth, "--html", str(file), "--quiet"]) == 0
    page, problems, requested = chromium.new_page(), [], []
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.on("request", lambda request: requested.append(request.url))

    page.goto(file.as_uri())

    drawn = page.evaluate(
        """() => { const canvas = document.getElementById("scene"), area = [0, 0, canvas.width, canvas.height];
        const pixels = new Uint32Array(canvas.getContext("2d").getImageData(...area).data.buffer);
        return new Set(pixels).size; }"""
    )
    filled = page.evaluate(
        """() => { const canvas = document.getElementById("scene"), [w, h] = [canvas.width, canvas.height];
        const pixels = new Uint32Array(canvas.getContext("2d").getImageData(0, 0, w, h).data.buffer);
        const x = [w, 0], y = [h, 0];
        pixels.forEach((color, k) => { if (!color) return; const c = k % w, r = Math.floor(k / w);
          x[0] = Math.min(x[0], c); x[1] = Math.max(x[1], c); y[0] = Math.min(y[0], r); y[1] = Math.max(y[1], r); });
        return Math.max((x[1] - x[0]) / w, (y[1] - y[0]) / h); }"""
    )
    page.set_viewport_size({"width": 400, "height": 800})
    page.locator("#picture").click()
    full = page.locator("#picture").bounding_box()
    page.locator("#picture").click()
    small = page.locator("#picture").bounding_box()
    page.close()
    assert full["width"] > 2 * small["width"]
    assert drawn > 100  # shades of the rings, planes and words
    assert filled > 0.85
    assert not problems
    assert {url for url in requested if not url.startswith("data:")} == {file.as_uri()}


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as free:
        return free.getsockname()[1]


@contextmanager
def served_console(folder):
    """Address of a console, and the folder in which it records."""
    for name in ("scene.yaml", "scene-rig.yaml"):
        shutil.copy(EXAMPLES / name, folder)
    options = ["--port", str(free_port()), "--output", "recorded"]
    words = [Path(sys.executable).parent / "ringpose", "simulate", "console", "scene.yaml", *options]
    with subprocess.Popen(words, cwd=folder, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        yield json.loads(process.stdout.readline())["page"], folder
        process.terminate()
        assert process.wait(300) == 143


@pytest.fixture(scope="module")
def console(tmp_path_factory):
    with served_console(tmp_path_factory.mktemp("console")) as served:
        yield served


@pytest.fixture
def page(chromium, console):
    with opened_page(chromium, console[0]) as opened:
        yield opened


@contextmanager
def opened_page(chromium, address):
    """A page with its first measurement, and the addresses that it requested."""
    context = chromium.new_context(viewport={"width": 640, "height": 480})
    context.set_default_timeout(WAIT_MS)
    opened = context.new_page()
    opened.requested = []
    opened.on("request", lambda request: opened.requested.append(request.url))
    opened.on("websocket", lambda websocket: opened.requested.append(websocket.url))
    opened.goto(address)
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


def reading(value):
    try:
        return float(value)
    except ValueError:
        return None


NUMBERS = ("focal length (%)", "pixel pitch (%)", "exposure (ms)", "tilt of left (deg)", "ambient light (W/m2)")
EXTREMES = ("0", "-5", "-1", "1000", "99", "199", "1e308", "0.0000001", "-", "", "12345678901234567890")


def test_20_drawn_values_that_are_typed_are_taken_or_named_and_limited_and_the_page_goes_on(chromium, tmp_path, rng):
    with served_console(tmp_path) as own, opened_page(chromium, own[0]) as page:
        page.get_by_role("tab", name="Rig and light").click()
        for _ in range(20):
            label = NUMBERS[rng.integers(len(NUMBERS))]
            typed = str(rng.choice(EXTREMES)) if rng.random() < 0.7 else str(rng.integers(50, 200))
            field = number_field(page, label)
            row = field.locator("xpath=ancestor::div[contains(@class, 'Flex-root')][2]")
            field.fill(typed)
            field.press("Tab")
            low, high = (float(each) for each in row.locator(".mantine-Slider-markLabel").all_inner_texts())
            page.wait_for_timeout(300)
            shown = reading(field.input_value())
            assert shown is None or low <= shown <= high, (label, typed)

        number = state_number(page)
        for label, value in zip(NUMBERS, ("100", "100", "5", "0", "0.5"), strict=True):
            number_field(page, label).fill(value)
        wait_for_newer_state(page, number)
        page.wait_for_selector("text=errors: centre", timeout=WAIT_MS)
        assert "internal error" not in page.inner_text("body")


def test_a_number_out_of_range_is_named_while_it_is_typed_and_limited_when_the_field_is_left(page):
    page.get_by_role("tab", name="Rig and light").click()
    field = number_field(page, "pixel pitch (%)")
    field.fill("0")
    page.wait_for_selector("text=not taken: 0 is out of range; it must be 50 to 200; 100 stays", timeout=WAIT_MS)
    field.press("Tab")
    page.wait_for_selector("text=limited to 50 to 200", timeout=WAIT_MS)
    assert field.input_value() == "50"
    field.fill("100")
    page.wait_for_selector("text=limited to 50 to 200", state="detached", timeout=WAIT_MS)


def test_a_page_of_another_origin_can_neither_open_the_socket_nor_show_the_page(console, chromium):
    address = console[0].removeprefix("http://")
    handler = type("Quiet", (SimpleHTTPRequestHandler,), {"log_message": lambda *_: None})
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as foreign:
        threading.Thread(target=foreign.serve_forever, daemon=True).start()
        page = chromium.new_page()
        page.goto(f"http://127.0.0.1:{foreign.server_port}/")
        opened = page.evaluate(
            """address => new Promise(done => {
                const socket = new WebSocket(`ws://${address}/`);
                socket.onopen = () => done("open"); socket.onerror = () => done("refused");
            })""",
            address,
        )
        page.evaluate(
            """address => new Promise(done => {
                const frame = document.createElement("iframe");
                frame.onload = done; frame.src = `http://${address}/`; document.body.append(frame);
            })""",
            address,
        )
        shown = [frame.url for frame in page.frames if frame.url.startswith(f"http://{address}")]
        page.close()
        foreign.shutdown()
    assert (opened, shown) == ("refused", [])


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

    page.get_by_role("tab", name="Rig and light").click()
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
    other = chromium.new_page(viewport={"width": 640, "height": 480})
    other.goto(console[0])
    other.wait_for_selector("text=errors: centre", timeout=WAIT_MS)
    assert number_field(other, "yaw (deg)").input_value() == value
    other.close()
    page.reload()
    page.wait_for_selector("text=errors: centre", timeout=WAIT_MS)
    assert number_field(page, "yaw (deg)").input_value() == value


def test_while_the_motion_plays_every_picture_has_the_stamp_of_its_state(page):
    page.get_by_role("checkbox", name="play").click()
    stamps = []
    for _ in range(5):
        page.wait_for_function(
            "before => !document.body.innerText.includes(before)",
            arg=f"camera: state {stamps[-1][0]}," if stamps else "waiting for the first measurement",
            timeout=WAIT_MS,
        )
        number, time_s = re.search(r"camera: state (\d+), ([\d.]+) s", page.inner_text("body")).groups()
        stamps.append((int(number), float(time_s)))
    page.get_by_role("checkbox", name="play").click()
    assert stamps == sorted(set(stamps))
    assert stamps[-1][1] > stamps[0][1]


def test_a_time_that_is_set_while_the_motion_plays_is_shown_and_in_step_each_state_is_measured(page):
    page.get_by_label("speed").click()
    page.get_by_role("option", name="0.25").click()
    page.get_by_role("checkbox", name="play").click()
    number_field(page, "time (s)").fill("51.5")
    page.wait_for_selector(r"text=/camera: state \d+, 5[1-9]\.\d\d s/", timeout=WAIT_MS)

    page.get_by_label("speed").click()
    page.get_by_role("option", name="each shot measured").click()
    number = state_number(page)
    for _ in range(2):
        wait_for_newer_state(page, number)
        number = state_number(page)
    page.get_by_role("checkbox", name="play").click()


def choose_file(page, button, file):
    with page.expect_file_chooser() as chooser:
        page.get_by_role("button", name=button).click()
    chooser.value.set_files(file)


def test_a_trajectory_and_a_rig_are_loaded_from_files(page, console, tmp_path):
    trajectory = tmp_path / "track.jsonl"
    poses = [{"center_m": [0.56, 0.05, z_m], "normal": [0.0, 0.1, -0.99]} for z_m in (0.4, 0.45)]
    trajectory.write_text("".join(json.dumps(pose) + "\n" for pose in poses).replace("0.99", "0.99498743710662"))
    number = state_number(page)
    choose_file(page, "load trajectory", trajectory)
    page.wait_for_selector("text=track.jsonl: 2 poses, 0.1 s", timeout=WAIT_MS)
    wait_for_newer_state(page, number)
    page.get_by_role("button", name="leave trajectory").click()

    page.get_by_role("tab", name="Rig and light").click()
    choose_file(page, "rig file", console[1] / "scene-rig.yaml")
    page.wait_for_selector("text=/scene-rig.yaml: \\w+/", timeout=WAIT_MS)
    (tmp_path / "bad.yaml").write_text("ringpose: rig/9\n")
    choose_file(page, "rig file", tmp_path / "bad.yaml")
    page.wait_for_selector("text=/not taken over: bad.yaml/", timeout=WAIT_MS)


def test_recorded_shots_are_shown_with_pose_track_and_errors_of_bench(chromium, carried_data, tmp_path, capsys):
    data = carried_data / "rig_b"
    shots = [str(data / "shots" / f"B_z0500_p0{number}_dim.npz") for number in (0, 1)]
    rig = ["--rig", str(data / "rig.yaml")]
    for name, words in (("poses", ["pose", *shots]), ("tracks", ["track", str(tmp_path / "poses.jsonl")])):
        assert main([*words, *rig]) in (0, 3)
        (tmp_path / f"{name}.jsonl").write_text(capsys.readouterr().out)
    words = ["view", *shots, *rig, "--quiet", "--port", str(free_port()), "--truth", str(data / "truth.jsonl")]
    files = [word for name in ("poses", "tracks") for word in (f"--{name}", str(tmp_path / f"{name}.jsonl"))]
    program = [Path(sys.executable).parent / "ringpose", *words, *files]
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as process:
        page = chromium.new_page(viewport={"width": 640, "height": 480})
        page.goto(json.loads(process.stdout.readline())["page"])
        page.wait_for_selector("text=shot 1 of 2", timeout=WAIT_MS)
        first = errors_in(page)
        assert "track: valid" in page.inner_text("body")
        page.get_by_role("button", name="next").click()
        page.wait_for_selector("text=B_z0500_p01_dim: shot 2 of 2", timeout=WAIT_MS)
        page.close()
        process.terminate()
        assert process.wait(300) == 143

    main(["bench", str(tmp_path / "poses.jsonl"), "--truth", str(data / "truth.jsonl"), *rig, "--json", "-"])
    scored = next(each for each in json.loads(capsys.readouterr().out)["shots"] if each["shot"] == "B_z0500_p00_dim")
    assert float(first["grasp"]) == pytest.approx(1e3 * scored["errors"]["grasp_m"], abs=6e-4)


def test_html_in_the_reason_of_a_record_is_shown_as_text(chromium, carried_data, tmp_path):
    data = carried_data / "rig_b"
    reason = "<img src=x onerror=\"document.title='run'\"> <b>bold</b> ![a](/etc/hostname) *b*"
    record = {"schema": "ringpose/pose/2", "shot": "B_z0500_p00_dim", "stamp_s": 0.0, "frame": "camera", "flags": []}
    (tmp_path / "poses.jsonl").write_text(json.dumps(record | {"status": "none", "pose": None, "reason": reason}))
    words = ["view", data / "shots" / "B_z0500_p00_dim.npz", "--rig", data / "rig.yaml", "--quiet"]
    program = [Path(sys.executable).parent / "ringpose", *words, "--poses", tmp_path / "poses.jsonl"]
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as process:
        page = chromium.new_page(viewport={"width": 640, "height": 480})
        page.goto(json.loads(process.stdout.readline())["page"])
        page.wait_for_selector("text=shot 1 of 1", timeout=WAIT_MS)
        assert reason in page.inner_text("body")
        assert page.title() != "run"
        page.close()
        process.terminate()
        assert process.wait(300) == 143


def test_in_a_narrow_window_the_scene_is_above_the_panel_and_fills_the_window_while_it_is_closed(page):
    page.set_viewport_size({"width": 400, "height": 800})
    page.wait_for_selector(".mantine-Paper-root", timeout=WAIT_MS)
    page.wait_for_function(
        """() => {
            const box = (name) => document.querySelector(name)?.getBoundingClientRect();
            const scene = box("canvas"), panel = box(".mantine-Paper-root[style*='max-height: 60%']");
            return panel && scene.width === 400 && panel.width === 400 && scene.bottom <= panel.top + 1;
        }"""
    )

    page.get_by_text("ringpose", exact=True).click()
    page.wait_for_function("() => document.querySelector('canvas').getBoundingClientRect().height > 700")


def test_the_errors_are_saved_as_csv_by_their_button(page):
    page.get_by_role("tab", name="Errors").click()
    with page.expect_download(timeout=WAIT_MS) as download:
        page.get_by_role("button", name="errors as CSV").click()
    head, first, *_ = Path(download.value.path()).read_text().splitlines()
    assert download.value.suggested_filename == "errors.csv"
    assert head.startswith("time since the start (s),error of the centre (mm)")
    assert len(first.split(",")) == len(head.split(","))


def test_image_and_controls_are_in_view_in_narrow_and_wide_windows(page):
    for width in (1024, 2560):
        page.set_viewport_size({"width": width, "height": 480})
        box = page.locator("img[src^='blob:']").first.bounding_box()
        assert box is not None
        assert box["width"] > 350
        assert 0 <= box["x"] <= width - box["width"]
