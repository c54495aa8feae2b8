"""The fields of messages of ROS 2."""

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
}
"""The definitions in common_interfaces and rcl_interfaces of ROS 2 (Jazzy), without comments."""


def fits(value, kind: str) -> bool:
    """Whether a value has exactly the fields of a message, with their types."""
    if kind == "float64[36]":
        return len(value) == 36 and all(isinstance(each, float) for each in value)
    if kind in ("int32", "uint32"):
        return isinstance(value, int) and 0 <= value < 2**31
    if kind in ("float64", "string"):
        return isinstance(value, float if kind == "float64" else str)
    fields = dict(reversed(line.split()[:2]) for line in MESSAGES[kind].splitlines())
    return list(value) == list(fields) and all(fits(value[name], fields[name]) for name in fields)
