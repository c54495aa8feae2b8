"""`ringpose bench`: poses compared with the truth, results compared with each other, studies, rig designs."""

from ringpose.cli.app import app
from ringpose.cli.bench.capture import capture
from ringpose.cli.bench.compare import compare
from ringpose.cli.bench.design import design
from ringpose.cli.bench.score import bench
from ringpose.cli.bench.study import study

app.command()(bench)
app.command("bench compare")(compare)
app.command("bench study")(study)
app.command("bench capture")(capture)
app.command("bench design")(design)
