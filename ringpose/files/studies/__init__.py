"""Studies: study.yaml and the presets, and the folder of a study's results."""
