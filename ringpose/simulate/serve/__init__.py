"""Stand-ins for the hardware: a camera on the network and relay boards, looking at a scene."""
