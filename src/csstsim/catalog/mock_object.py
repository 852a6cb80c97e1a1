"""MockObject: one astronomical object, the paper's unit of input (section 4, Appendix A)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Self, overload

from csstsim.base.errors import InputError
from csstsim.catalog.table import COLUMNS, MAGNITUDE, OPTIONAL, TYPES, ObjectTable

if TYPE_CHECKING:
    from csstsim.base.types import AnyArray


class MockObject:
    """One object; its values are attributes named as the columns of `catalog.table` (units there).

    Made from keywords by a catalogue of your own, `MockObject(id=1, type="star", ra=10.0, dec=-2.0,
    teff=5800, spectrum="g2v.fits")`, or as a view of a row of an ObjectTable, `MockObject.view(table, row)`.
    Names that are not columns (`spectrum`) are kept for your `load_sed`. Columns not given have their default.
    Raises InputError for an unknown type.
    """

    __slots__ = ("_columns", "_row")
    _columns: Mapping[str, Sequence[Any] | AnyArray]
    _row: int

    def __init__(self, *, type: str | None = None, **values: Any) -> None:
        if type is not None:
            if type not in TYPES:
                raise InputError(
                    f"object {values.get('id')} is of unknown type",
                    key="type",
                    value=str(type),
                    allowed=", ".join(TYPES),
                )
            values["obj_type"] = TYPES.index(type)
        self._columns = {name: (value,) for name, value in values.items()}
        self._row = 0

    @classmethod
    def view(cls, table: ObjectTable, row: int) -> Self:
        """Return row `row` of an ObjectTable as an object; it sees later changes of the table's arrays."""
        self = cls.__new__(cls)
        self._columns = table
        self._row = row
        return self

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name in MockObject.__slots__:
            raise AttributeError(name)
        if name in self._columns:
            return self._columns[name][self._row]
        for columns in (COLUMNS, OPTIONAL):
            if name in columns:
                return columns[name][1]
        if name.startswith("mag_") and name != "mag_norm":  # of any camera's band
            return MAGNITUDE[1]
        raise AttributeError(f"object has no {name!r}; it has {', '.join(sorted(self._columns))}")

    @property
    def type(self) -> str:
        """'star', 'galaxy' or 'quasar'; 'unknown' for any other obj_type."""
        return dict(enumerate(TYPES)).get(int(self.obj_type), "unknown")

    @property
    def position(self) -> tuple[float, float]:
        """(ra, dec) [deg, ICRS]."""
        return self.ra, self.dec

    @property
    def values(self) -> dict[str, Any]:
        """The object's values by name, without defaults."""
        return {name: self._columns[name][self._row] for name in self._columns}

    def __repr__(self) -> str:
        return f"MockObject({self.type} {self.id} at ra={self.ra}, dec={self.dec})"


class MockObjects(Sequence[MockObject]):
    """The rows of an ObjectTable as MockObjects, made when asked for."""

    def __init__(self, table: ObjectTable) -> None:
        self._table = table

    def __len__(self) -> int:
        return len(self._table)

    @overload
    def __getitem__(self, row: int) -> MockObject: ...

    @overload
    def __getitem__(self, row: slice) -> MockObjects: ...

    def __getitem__(self, row: int | slice) -> MockObject | MockObjects:
        if isinstance(row, slice):
            return MockObjects(self._table.take(row))
        if not -len(self) <= row < len(self):
            raise IndexError(row)
        return MockObject.view(self._table, row)
