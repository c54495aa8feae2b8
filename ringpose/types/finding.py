"""What the stages of a measurement find out about a shot; `ringpose.measure.status` decides its flags from it."""

from enum import IntFlag, auto


class Finding(IntFlag):
    """A condition that a stage reports; several may hold."""

    # Explanation of the shot: what must be wrong for the rest to fit one ring
    WRONG_POINT = auto()
    WRONG_ENDS = auto()
    """One of the two break points of a stripe is wrong, or both are."""
    WRONG_STRIPE = auto()
    WRONG_EDGES = auto()
    """The visible points of the edges are of something else."""
    WRONG_LASERS = auto()
    """The stripes fit a ring only, or about as well, as those of other lasers."""
    WRONG_RADIUS = auto()
    """The ring does not have the assumed radii."""
    FASTER = auto()
    """The target moves faster than assumed."""
    MOVED = auto()
    """The target was not still, as assumed."""
    FRAME_DIFFERS = auto()
    """A frame with all lasers contradicts those with one."""
    NOT_ROUND = auto()
    """The ring deviates from a circle or a plane by more than assumed."""
    UNEXPLAINED = auto()
    """The measurements contradict one ring, and no single part is to blame."""

    # What the shot, or the track, leaves open
    CENTER_OPEN = auto()
    NORMAL_OPEN = auto()
    GRASP_OPEN = auto()
    RADIUS_OPEN = auto()
    VELOCITY_OPEN = auto()
    SIDE_OPEN = auto()
    """On which side of the face the ring's centre lies."""

    # Why nothing of a pose can be relied on
    NO_ERRORS = auto()
    """The covariance of a break point is not known."""
    NOT_TIMED = auto()
    """The target may have moved between frames that have no stamps of their own."""
    NOT_CONVERGED = auto()
    STRAIGHT = auto()
    """The edges may be straight."""
    OTHER_SURFACE = auto()
    """The visible edges do not predict the single stripe."""
    FEW_ENDS = auto()
    """Too few ends of stripes are clear, and no edge is visible."""

    # What the pose assumes without a check by the shot
    RADIUS_ASSUMED = auto()
    FEW_STRIPES = auto()
    """One or two stripes have no redundancy that could show an error of the rig."""
    ONE_STRIPE_ALONE = auto()
    """The two ends of a single stripe, without visible edges."""
    SEVERAL_FACES = auto()
    """Another face is at the same height about the same axis, and no radii are given."""

    # What should be in view but was not used
    DISPLACED_STRIPE = auto()
    """A third stripe is near the ring of two others, but not on it."""
    NO_EDGES = auto()
    """Ambient light should show the ring's edges, but they were not found."""
    POINT_UNUSED = auto()
    POINT_SATURATED = auto()
    POINT_CUT_OFF = auto()
    STRIPE_UNUSED = auto()
    STRIPE_NOT_FOUND = auto()
    BLUNT = auto()
    """The stripes fade over more columns at the edges than the optical blur explains."""

    AMBIENT_CHANGED = auto()
    GHOST_REMOVED = auto()
    """Fainter copies of the stripes were subtracted from the frames."""

    # What a stream of shots has shown
    PLANE_MOVED = auto()
    PLANE_OR_CAMERA_MOVED = auto()
    """A turn of the camera explains the shots about as well as the plane of a laser that has moved."""
    RIG_DISAGREES = auto()
    """The stripes disagree with the rig, and not by one plane alone."""
    SHOTS_CONTRADICT = auto()
    """Most of the last shots contradict one ring."""
    RIG_DOUBTED = auto()
    """The rig has changed in a way that is not corrected, or that the shot cannot check."""
    RADII_DIFFER = auto()
    """The radii of the last shots differ by more than their errors."""
    TRACK_CONTRADICTED = auto()
    """The newest measurement contradicts the track, or its clock does."""


NOTHING = Finding(0)
