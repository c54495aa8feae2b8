"""Options that turn a command into another one, which would leave most of the others aside."""

from typing import Any

from typer.core import TyperCommand

PRINTING = frozenset(("print_board", "board", "force", "verbose", "quiet"))
"""What goes together with `--print-board`."""

CHECKING = frozenset(
    ("check", "inputs", "board", "laser_order", "surround", "overlay", "channel", "force", "verbose", "quiet")
)
"""What goes together with `--check`."""

_MODES = {
    "print_board": ("--print-board", "only draws the board", PRINTING),
    "check": ("--check", "only compares, with the rig's own camera", CHECKING),
}


_NONE: tuple[Any, ...] = (None, (), [])


class CommandWithModes(TyperCommand):
    """A command that refuses options beside a mode rather than leave them aside without a word."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command."""
        from ringpose.errors import UsageError

        for mode, (name, found, welcome) in _MODES.items():
            others = [words for key, words in _given(ctx).items() if key not in welcome]
            if ctx.params.get(mode) is not None and others:
                raise UsageError(name, found, f"leave out {', '.join(others)}")
        return super().invoke(ctx)


def _given(ctx: Any) -> dict[str, str]:
    """What the command line gives, by its name in the code: the option as it is written, or the inputs.

    Typer 0.26.0 to 0.26.6 name the command line as the source of inputs that are not there.
    """
    return {
        parameter.name: max(parameter.opts, key=len) if parameter.param_type_name == "option" else "the inputs"
        for parameter in ctx.command.params
        if ctx.get_parameter_source(parameter.name).name == "COMMANDLINE"
        and ctx.params.get(parameter.name) not in _NONE
    }
