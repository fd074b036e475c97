"""Optional libraries and the extras that install them."""

from __future__ import annotations

from rfpp.errors import MissingDependencyError

#: Top-level module → extra of pyproject.toml.
EXTRAS = {
    "fast_simplification": "data",
    "h5py": "data",
    "lpips": "training",
    "manifold3d": "data",
    "skimage": "data",
    "matplotlib": "evaluation",
    "mitsuba": "outside",
    "mlflow": "tracking",
    "starlette": "serve",
    "uvicorn": "serve",
    "viser": "viewer",
}


def missing_extra(error: BaseException) -> MissingDependencyError | None:
    """Return a one-line error that names the extra of a missing library; None for other errors.

    Args:
        error: exception; its causes count too, because Hydra wraps exceptions.
    """
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, ModuleNotFoundError) and cause.name:
            library = cause.name.partition(".")[0]
            if library in EXTRAS:
                return MissingDependencyError(f"{library} is not installed: pip install 'rfpp[{EXTRAS[library]}]'")
        cause = cause.__cause__ or cause.__context__
    return None
