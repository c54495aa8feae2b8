"""Time that passes only while a test's devices wait or expose, in place of the module `time`."""


class VirtualTime:
    """The functions of `time` that the capture uses; their clocks are the same."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def time(self) -> float:
        return self.now_s

    monotonic = perf_counter = time

    def sleep(self, duration_s: float) -> None:
        self.now_s += duration_s
