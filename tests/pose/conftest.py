"""Scenes of known rings for the tests of this folder."""

from ring_scenes import break_points_at, face_points, ring_scene, scene_of, visible_edges

__all__ = ["break_points_at", "face_points", "ring_scene", "scene_of", "visible_edges"]
