"""The segments of a photograph, of which nothing else is known."""

from ringpose.detect.frames import most_lit_image
from ringpose.detect.segments import find_segments
from ringpose.types.detection import Detection, NoBreakPoints
from ringpose.types.frame import Shot
from ringpose.types.options import SegmentMethod


def segments_only(shot: Shot, method: SegmentMethod = SegmentMethod.REFINED) -> Detection:
    """The segments of the shot's brightest-lit frame; break points are not looked for."""
    return Detection(
        shot=shot.name,
        stamp_s=shot.measured_at_s,
        break_points=NoBreakPoints.NOT_SOUGHT,
        segments=find_segments(most_lit_image(shot), method=method, saturation_dn=shot.saturation_dn),
    )
