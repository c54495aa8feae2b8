"""The fields of messages of ROS 2, and classes that take nothing else, as those that ROS generates."""

from functools import cache

MESSAGES = {
    "geometry_msgs/PoseWithCovarianceStamped": "std_msgs/Header header\nPoseWithCovariance pose",
    "PoseWithCovariance": "Pose pose\nfloat64[36] covariance",
    "Pose": "Point position\nQuaternion orientation",
    "Point": "float64 x\nfloat64 y\nfloat64 z",
    "Quaternion": "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1",
    "geometry_msgs/TwistWithCovarianceStamped": "std_msgs/Header header\nTwistWithCovariance twist",
    "TwistWithCovariance": "Twist twist\nfloat64[36] covariance",
    "Twist": "Vector3  linear\nVector3  angular",
    "Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "geometry_msgs/TransformStamped": "std_msgs/Header header\nstring child_frame_id\nTransform transform",
    "Transform": "Vector3 translation\nQuaternion rotation",
    "diagnostic_msgs/DiagnosticArray": "std_msgs/Header header\nDiagnosticStatus[] status",
    "DiagnosticStatus": "byte level\nstring name\nstring message\nstring hardware_id\nKeyValue[] values",
    "KeyValue": "string key\nstring value",
}
"""The definitions in common_interfaces and rcl_interfaces of ROS 2 (Jazzy), without comments and constants."""

CONSTANTS = {"DiagnosticStatus": {"OK": b"\x00", "WARN": b"\x01", "ERROR": b"\x02", "STALE": b"\x03"}}
"""Those of the definitions; a byte is an object of bytes in Python."""

PLAIN = {"float64": 0.0, "string": "", "int32": 0, "uint32": 0, "byte": b"\x00", "float64[36]": [0.0] * 36}
"""Default values."""


def fits(value, kind: str) -> bool:
    """Whether a value has exactly the fields of a message, with their types."""
    if kind == "float64[36]":
        return len(value) == 36 and all(isinstance(each, float) for each in value)
    if kind in ("int32", "uint32"):
        return isinstance(value, int) and 0 <= value < 2**31
    if kind in ("float64", "string"):
        return isinstance(value, float if kind == "float64" else str)
    if kind == "byte":
        return isinstance(value, bytes) and len(value) == 1
    if kind.endswith("[]"):
        return all(isinstance(each, class_of(kind[:-2])) for each in value)
    if kind not in PLAIN and not isinstance(value, dict):
        return isinstance(value, class_of(kind))
    fields = fields_of(kind)
    return list(value) == list(fields) and all(fits(value[name], fields[name]) for name in fields)


def fields_of(kind: str) -> dict[str, str]:
    """The fields of a message and their types."""
    return dict(reversed(line.split()[:2]) for line in MESSAGES[kind].splitlines())


@cache
def class_of(kind: str) -> type:
    """A class of a message, whose fields are checked when they are set."""
    fields = fields_of(kind)

    def init(self, **given) -> None:
        for name, its_kind in fields.items():
            default = [] if its_kind.endswith("[]") else PLAIN.get(its_kind)
            setattr(self, name, given.pop(name, class_of(its_kind)() if default is None else default))
        assert not given, f"{kind} has no {given}"

    def set_checked(self, name: str, value) -> None:
        assert name in fields, f"{kind} has no {name}"
        assert fits(value, fields[name]), f"{name} of {kind} is not {value!r}"
        object.__setattr__(self, name, value)

    return type(kind.split("/")[-1], (), {"__init__": init, "__setattr__": set_checked, **CONSTANTS.get(kind, {})})
