"""`ringpose bench`: poses against truth, line detectors against each other, times against limits."""

from ringpose.cli.app import app
from ringpose.cli.bench.compare import compare
from ringpose.cli.bench.detectors import detectors
from ringpose.cli.bench.score import bench
from ringpose.cli.bench.speed import speed

app.command()(bench)
app.command("bench compare")(compare)
app.command("bench detectors")(detectors)
app.command("bench speed")(speed)
