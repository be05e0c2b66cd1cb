"""Settings of a sweep: combinations of hyper-parameters, of a grid or of points, and their names."""

import itertools
from collections.abc import Hashable, Iterator

import xarray as xr


def along_points(values: xr.DataArray) -> list[str]:
    """Hyper-parameters that the values have along the dimension of points, if there is one."""
    return [str(name) for name, coord in values.coords.items() if coord.dims == ("point",) and name != "point"]


def settings(values: xr.DataArray, *rest: Hashable) -> Iterator[tuple[xr.DataArray, str]]:
    """The values of every combination of hyper-parameters, which are all dimensions but the rest, and its name."""
    swept = [dim for dim in values.dims if dim not in rest]
    for chosen in itertools.product(*(values[dim].values for dim in swept)):
        one = values.sel(dict(zip(swept, chosen, strict=True)))
        names = [name for dim in swept for name in (dim == "point" and along_points(values)) or [dim]]
        yield one, ", ".join(f"{name}={float(one[name]):g}" for name in names)
