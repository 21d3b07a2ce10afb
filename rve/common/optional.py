"""Types of packages that are imported only when they are used, for annotations: `Any` while the program runs."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.figure import Figure as Figure
    from pandas import DataFrame as DataFrame
    from pyvista import Plotter as Plotter
    from pyvista import PolyData as PolyData
else:
    Axes = DataFrame = Figure = Plotter = PolyData = Any
