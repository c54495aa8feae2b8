"""The noise of pixels, stripe centres, stripe ends and visible edges, for the detector and for the simulator."""
