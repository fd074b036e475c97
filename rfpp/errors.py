"""Errors that a user can cause and fix.

Every entry point prints such an error as one line and exits with status 1; anything else is a bug and keeps
its traceback.
"""


class UserError(Exception):
    """Bad input or a missing prerequisite. The message names the file (or setting) and says what to do."""


class SceneError(UserError):
    """A scene file, mesh, material or camera that cannot be rendered as it stands."""


class ShardError(UserError):
    """A data set that is incomplete, damaged or made by another schema version."""


class CheckpointError(UserError):
    """A checkpoint that is unreadable or belongs to another model."""


class MissingDependencyError(UserError):
    """An optional library, program or weight file is needed and not there."""


def one_line(text: str, length: int = 200) -> str:
    """Make text from a file safe for messages and names: printable, one line, bounded length."""
    kept = "".join(c if c.isprintable() else " " for c in text[: 4 * length])
    return kept if len(kept) <= length else f"{kept[:length]}…"
