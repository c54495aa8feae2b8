"""The example package for ROS 2, whose node runs with stand-ins for rclpy and messages that take only their fields."""

import json
import runpy
import sys
import types
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from moving_rings import Shots, drawn_motion, stream
from ros_messages import class_of
from scipy.spatial.transform import Rotation

from ringpose.files.records.robot_poses import RECORD
from ringpose.files.records.ros import ros_messages
from ringpose.measure.status import RULES
from ringpose.track.pipeline import Tracker
from ringpose.types.pose import HARMLESS_FLAGS, PoseFlag

PACKAGE = Path(__file__).parents[1] / "examples" / "ringpose_ros"

TOOL_FROM_CAMERA = [[0.0, -1.0, 0.0, 0.1], [1.0, 0.0, 0.0, 0.2], [0.0, 0.0, 1.0, -0.3], [0.0, 0.0, 0.0, 1.0]]

COMMAND = """\
import json, pathlib, sys
options = sys.argv[1:]
robot = [sys.stdin.readline() for _ in range(2)] if "--robot-poses" in options else []
pathlib.Path("given.json").write_text(json.dumps([options, robot]))
print(pathlib.Path("lines.jsonl").read_text(), end="", flush=True)
sys.exit(3)
"""
"""Stands for ringpose: writes down its options and two poses of the robot, then its lines."""


class StubNode:
    """The part of rclpy's Node that is used; parameters are those in `given`."""

    given: dict

    def __init__(self, name: str) -> None:
        self.sent: dict[str, list] = {}
        self.timers: list = []

    def declare_parameter(self, name, value):
        chosen = self.given.get(name, value)
        assert type(chosen) is type(value)
        return types.SimpleNamespace(value=chosen)

    def create_publisher(self, kind, topic, depth):
        sent = self.sent.setdefault(topic, [])

        def publish(message) -> None:
            assert isinstance(message, kind)
            sent.append(message)

        return types.SimpleNamespace(publish=publish)

    def create_timer(self, period_s, callback):
        self.timers.append(callback)

    def get_clock(self):
        stamp = class_of("builtin_interfaces/Time")(sec=5, nanosec=6)
        return types.SimpleNamespace(now=lambda: types.SimpleNamespace(to_msg=lambda: stamp))


class StubBuffer:
    """A TF tree in which the tool moves; every pose is looked up twice."""

    calls = 0

    def lookup_transform(self, target, source, time):
        assert (target, source) == ("world", "tool0")
        self.calls += 1
        message = class_of("geometry_msgs/TransformStamped")()
        message.header.stamp.sec, message.transform.translation.x = 100 + self.calls // 2, 0.25
        message.transform.rotation.z = message.transform.rotation.w = 0.5**0.5
        return message


class StubBroadcaster:
    """Keeps the static transforms with the messages of the node."""

    def __init__(self, node) -> None:
        self.sendTransform = node.sent.setdefault("/tf_static", []).append


@pytest.fixture
def package(monkeypatch):
    """The node's module, imported with stand-ins for ROS."""
    messages = {
        "diagnostic_msgs": ["diagnostic_msgs/DiagnosticArray", "DiagnosticStatus", "KeyValue"],
        "geometry_msgs": [f"geometry_msgs/{kind}Stamped" for kind in ("PoseWithCovariance", "Transform")],
    }
    messages["geometry_msgs"] += ["geometry_msgs/TwistWithCovarianceStamped"]
    tree = {"Buffer": StubBuffer, "TransformListener": lambda tree, node: None, "TransformException": RuntimeError}
    stubs = {
        "rclpy": {},
        "rclpy.node": {"Node": StubNode},
        "rclpy.time": {"Time": lambda: None},
        "rclpy.executors": {"ExternalShutdownException": InterruptedError},
        "tf2_ros": {**tree, "StaticTransformBroadcaster": StubBroadcaster},
        **{f"{name}.msg": {kind.split("/")[-1]: class_of(kind) for kind in kinds} for name, kinds in messages.items()},
        **{name: {} for name in messages},
    }
    for name, attributes in stubs.items():
        monkeypatch.setitem(sys.modules, name, types.ModuleType(name))
        sys.modules[name].__dict__.update(attributes)
    monkeypatch.syspath_prepend(str(PACKAGE))
    from ringpose_ros import node

    yield node
    for name in [name for name in sys.modules if name.split(".")[0] == "ringpose_ros"]:
        monkeypatch.delitem(sys.modules, name)


@pytest.fixture(scope="module")
def line() -> dict:
    """A line of a track, as messages."""
    tracker = Tracker(None)
    records = stream(drawn_motion(np.random.default_rng(7)), 1.0, Shots(), np.random.default_rng(8))
    tracked = [tracker.line_of(tracker.add(replace(record, rig="a" * 64))) for record in records][-1]
    return json.loads(json.dumps(ros_messages(replace(tracked, latency_s=0.05))))


@pytest.fixture
def run(package, tmp_path, monkeypatch):
    """Runs the node with these lines until its command has ended."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "command.py").write_text(COMMAND)
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump({"mount": {"tool_from_camera": TOOL_FROM_CAMERA}}))

    def started(*lines: dict, **given):
        (tmp_path / "lines.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
        StubNode.given = {"rig": "rig.yaml", "command": f"{sys.executable} command.py", "base_frame": "world"} | given
        node = package.RingposeNode()
        while not node.has_ended:
            for callback in node.timers:
                callback()
        node.diagnose()
        return node, node.close()

    return started


def test_messages_are_published_in_the_named_frames_and_the_mount_is_a_static_transform(run, line, tmp_path):
    node, status = run(line)

    assert status == 3
    assert json.loads((tmp_path / "given.json").read_text())[0] == ["--rig", "rig.yaml", "--format", "ros", "--newest"]
    (pose,), (twist,), (mount,) = (node.sent[topic] for topic in ("ring/pose", "ring/twist", "/tf_static"))
    assert pose.header.frame_id == twist.header.frame_id == mount.child_frame_id == "camera_optical_frame"
    assert pose.pose.pose.position.x == line["pose"]["pose"]["pose"]["position"]["x"]
    assert twist.twist.covariance == line["twist"]["twist"]["covariance"]
    assert mount.header.frame_id == "tool0"
    turn, place = mount.transform.rotation, mount.transform.translation
    np.testing.assert_allclose([place.x, place.y, place.z], [0.1, 0.2, -0.3])
    matrix = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
    np.testing.assert_allclose(matrix, np.array(TOOL_FROM_CAMERA)[:3, :3], atol=1e-12)


def test_diagnostics_state_the_newest_line_and_that_the_command_has_ended(run, line, package):
    node, _ = run(line)

    (status,) = node.sent["/diagnostics"][-1].status
    texts = {each.key: each.value for each in status.values}
    assert (status.level, status.message) == (b"\x02", "ringpose has ended with status 3")
    assert texts.items() >= {"lines": "1", "validity": "valid", "latency_s": "0.05", "flags": ""}.items()
    lines = package.lines
    assert lines.summary(line, 0.1, 1.0) == (lines.OK, "ok")
    assert lines.summary(line, 2.0, 1.0) == (lines.STALE, "no line for 2.0 s")
    assert lines.summary(None, 2.0, 1.0) == (lines.STALE, "no line yet")
    assert lines.summary({**line, "validity": "predicted"}, 0.1, 1.0) == (lines.WARN, "predicted")
    without = {**line, "pose": None, "status": "none", "reason": "the image is dark"}
    assert lines.summary(without, 0.1, 1.0) == (lines.ERROR, "the image is dark")


@pytest.mark.parametrize(
    ("changes", "published"),
    [
        ({"flags": ["inconsistent"]}, []),
        ({"flags": ["velocity_weak"]}, ["ring/pose"]),
        ({"flags": ["center_weak"]}, ["ring/twist"]),
        ({"validity": "predicted"}, []),
        ({"pose": None, "twist": None, "validity": "lost", "status": "none"}, []),
        ({"flags": ["point_rejected"], "status": "degraded"}, ["ring/pose", "ring/twist"]),
    ],
    ids=str,
)
def test_what_a_flag_forbids_to_use_is_not_published(run, line, changes, published):
    node, _ = run({**line, **changes})

    assert [topic for topic in ("ring/pose", "ring/twist") if node.sent[topic]] == published


def test_the_flags_are_those_that_forbid_to_use_what_a_message_has(package):
    def forbidding(*quantities: str) -> set[str]:
        rules = [rule for rule in RULES if rule.forbids & set(quantities) and not rule.flag & HARMLESS_FLAGS]
        return {str(rule.flag.name).lower() for rule in rules} | {str(PoseFlag.RIG_DRIFT.name).lower()}

    assert {"pose": forbidding("center", "normal"), "twist": forbidding("velocity")} == package.lines.WITHHELD


def test_the_poses_of_the_tf_tree_are_given_to_the_command_once_each(run, line, tmp_path):
    run(line, robot_rate_hz=50.0)

    options, robot = json.loads((tmp_path / "given.json").read_text())
    assert options[-2:] == ["--robot-poses", "-"]
    poses = [RECORD.read(json.loads(text), "-") for text in robot]
    assert [pose.stamp_s for pose in poses] == [100.0, 101.0]
    np.testing.assert_allclose(poses[0].base_from_tool.position_m, [0.25, 0, 0])
    np.testing.assert_allclose(poses[0].base_from_tool.orientation_xyzw, [0, 0, 0.5**0.5, 0.5**0.5])


def test_a_camera_beside_the_robot_is_placed_in_the_base_and_a_rig_without_mount_nowhere(run, line, tmp_path):
    (tmp_path / "base.yaml").write_text(yaml.safe_dump({"mount": {"base_from_camera": TOOL_FROM_CAMERA}}))
    (tmp_path / "bare.yaml").write_text("camera: {}")

    (mount,) = run(line, rig="base.yaml")[0].sent["/tf_static"]

    assert (mount.header.frame_id, mount.child_frame_id) == ("world", "camera_optical_frame")
    assert run(line, rig="bare.yaml")[0].sent["/tf_static"] == []
    with pytest.raises(SystemExit, match="the parameter rig is missing"):
        run(line, rig="")


def test_the_launch_file_sets_every_parameter_of_the_node_and_the_package_installs_both(package, monkeypatch):
    recorded = {}
    actions = types.SimpleNamespace(DeclareLaunchArgument=lambda name, **given: recorded.update({name: given}))
    stubs = {
        "launch": {"LaunchDescription": list},
        "launch.actions": vars(actions),
        "launch.substitutions": {"LaunchConfiguration": lambda name: name},
        "launch_ros": {},
        "launch_ros.actions": {"Node": dict},
        "launch_ros.parameter_descriptions": {"ParameterValue": lambda name, value_type: value_type},
        "setuptools": {"setup": recorded.update, "find_packages": lambda where: ["ringpose_ros"]},
    }
    for name, attributes in stubs.items():
        monkeypatch.setitem(sys.modules, name, types.ModuleType(name))
        sys.modules[name].__dict__.update(attributes)
    sys.modules["setuptools"].setup = lambda **given: recorded.update(setup=given)

    *_, node = runpy.run_path(str(PACKAGE / "launch" / "ring.launch.py"))["generate_launch_description"]()
    runpy.run_path(str(PACKAGE / "setup.py"))

    setup = recorded.pop("setup")
    (kinds,) = node["parameters"]
    assert {name: kinds[name](given["default_value"]) for name, given in recorded.items()} == package.DEFAULTS
    assert setup["entry_points"] == {"console_scripts": [f"{node['executable']} = ringpose_ros.node:main"]}
    assert callable(package.main)
    assert node["package"] == setup["name"]
    assert all((PACKAGE / file).is_file() for _, files in setup["data_files"] for file in files)
    needed = {each.text for each in ElementTree.parse(PACKAGE / "package.xml").iter("exec_depend")}
    assert needed == {
        *("diagnostic_msgs", "geometry_msgs", "rclpy", "tf2_ros_py", "launch", "launch_ros"),
        *("python3-numpy", "python3-yaml"),
    }
