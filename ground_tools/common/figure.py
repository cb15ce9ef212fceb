"""Matplotlib figures in the project's style, without a display.

matplotlib is an optional dependency and imported on use.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from companion.errors import ConfigError
from companion.shipped import how_to_install

_STYLE: Any = {
    "font.size": 13.5,
    "axes.titlesize": 14,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e4e4e4",
    "axes.axisbelow": True,
}


@contextmanager
def drawn(path: Path, size_in: tuple[float, float], dpi: int = 130) -> Iterator[Any]:
    """Yield an empty figure to draw on, and write it to a PNG file at the end.

    Args:
        path: The PNG file, from the option --out.
        size_in: Width and height in inches.
        dpi: Resolution in dots per inch.

    Raises:
        ConfigError: matplotlib is not installed, or `path` cannot be written. If possible, this is detected
            before anything is drawn.
    """
    # Without this check matplotlib would write FILE.png for FILE, even if FILE is a folder.
    if path.suffix.lower() != ".png":
        raise ConfigError(f"--out: {path}: cannot be written: the file name must end in .png")
    if path.is_dir() or not path.parent.is_dir():
        why = "it is a folder" if path.is_dir() else f"the folder {path.parent} does not exist"
        raise ConfigError(f"--out: {path}: cannot be written: {why}")
    with styled(size_in) as figure:
        yield figure
        try:
            figure.savefig(path, dpi=dpi)
        except (OSError, ValueError) as error:
            raise ConfigError(f"--out: {path}: cannot be written: {error}") from error


@contextmanager
def styled(size_in: tuple[float, float], **style: Any) -> Iterator[Any]:
    """Yield an empty figure in the project's style.

    Args:
        size_in: Width and height in inches.
        style: matplotlib settings that override the style.

    Raises:
        ConfigError: matplotlib is not installed.
    """
    try:
        import matplotlib
    except ImportError as error:
        raise ConfigError(how_to_install("matplotlib", "inspect")) from error
    with matplotlib.rc_context(_STYLE | style):
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
        from matplotlib.layout_engine import ConstrainedLayoutEngine

        figure = Figure(figsize=size_in, layout=ConstrainedLayoutEngine(h_pad=0.1))
        FigureCanvasAgg(figure)
        yield figure
