"""`ringpose bench`: poses compared with the truth, results compared with each other, times on this machine."""

from ringpose.cli.app import app
from ringpose.cli.bench.compare import compare
from ringpose.cli.bench.design import design
from ringpose.cli.bench.score import bench
from ringpose.cli.bench.speed import speed
from ringpose.cli.bench.study import study

app.command()(bench)
app.command("bench compare")(compare)
app.command("bench speed")(speed)
app.command("bench study")(study)
app.command("bench design")(design)
