"""The search for a board in a process of its own, which a signal or too much CPU time ends."""

from ringpose.calibrate.boards.diagnostics import BoardFailure, NoBoard
from ringpose.calibrate.boards.views import find_board
from ringpose.processes import LimitedCalls, WorkerKilled
from ringpose.types.arrays import Array, UInt
from ringpose.types.board import Board, BoardView

MAX_SEARCH_S, MAX_SEARCH_S_PER_PIXEL = 10, 1e-5
"""CPU time after which a search is given up: 22 s for 1.2 megapixels, where a board takes 2 s and an image without one
0.8 s; thrice that leaves room for slow processors."""


class BoardSearch:
    """`find_board` for one image after the other, in one child process that lives as long as the `with` block."""

    def __init__(self) -> None:
        self._calls: LimitedCalls[BoardView | NoBoard] = LimitedCalls(find_board)

    def __enter__(self) -> "BoardSearch":
        return self

    def __exit__(self, *_: object) -> None:
        self._calls.__exit__()

    def __call__(self, image: UInt[Array, "row column"], board: Board, name: str) -> BoardView | NoBoard:
        """The board's corners in the image, or the reason why there are none (`find_board`)."""
        limit_s = MAX_SEARCH_S + int(MAX_SEARCH_S_PER_PIXEL * image.size)
        try:
            return self._calls(limit_s, image, board, name)
        except WorkerKilled:
            return NoBoard(failure=BoardFailure.GIVEN_UP, found=f"after {limit_s} s of computing, or killed")
