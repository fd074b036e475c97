"""Progress lines for outputs that show no bar."""

import io

from rich.console import Console
from rich.progress import Progress

from rfpp.progress import Count, counting


def lines_at(*steps: tuple[float, int]) -> list[str]:
    """Return the lines written for counts at these times."""
    now, output = [0.0], io.StringIO()
    count = Count(Progress(console=Console(file=output, width=200)), "steps", 1, clock=lambda: now[0])
    for seconds, done in steps:
        now[0] = seconds
        count.show(done, 650)
    return [line for line in output.getvalue().splitlines() if "left" in line]


def test_the_first_line_comes_early_with_an_estimate_of_the_time():
    written = lines_at(*((2.0 * step, step) for step in range(12)))
    assert written == ["steps 10 of 650, 0.5 per second, about 0:21:20 left"]


def test_things_done_before_do_not_count_as_speed():
    assert lines_at((0.0, 600), (5.0, 610)) == ["steps 610 of 650, 2 per second, about 0:00:20 left"]


def test_files_get_lines_and_terminals_a_bar():
    for terminal in (False, True):
        output = io.StringIO()
        console = Console(file=output, force_terminal=terminal, width=100)
        with counting(console, "images") as (show, _):
            for done in range(13):
                show(done, 20, f"note {done}" if done % 2 == 0 else None)
        assert ("images 10 of 20" in output.getvalue()) != terminal
        assert ("note 12" if terminal else "note 10") in output.getvalue()
