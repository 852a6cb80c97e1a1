"""The setting of `csstsim bench` for benchmarks: one chip, its PSF set (kept with the results), an exposure."""

from evidence.record import Record

from csstsim.bench import setting
from csstsim.bench.setting import Setting

TOY_GRID = 3  # nodes along a side, at the size of seconds


def setting_of(record: Record, band: str) -> Setting:
    """Return the Setting of a filter."""
    if record.toy:
        setting.GRID = TOY_GRID
    return setting.make_setting(record.results / "bench", band)
