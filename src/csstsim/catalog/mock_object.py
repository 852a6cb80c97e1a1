"""MockObject: one astronomical object, the paper's unit of input (section 4, Appendix A)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Self, overload

from csstsim.base.errors import InputError
from csstsim.catalog.table import COLUMNS, MAGNITUDE, OPTIONAL, TYPES, ObjectTable

if TYPE_CHECKING:
    from csstsim.base.types import AnyArray


class MockObject:
    """One object; its values are attributes with the names and units of the columns of `catalog.table`.

    Other names (`spectrum` below) are stored for your `load_sed`. Columns that are not given have their default.

    Parameters
    ----------
    type : {"star", "galaxy", "quasar", "asteroid", "satellite"}, optional
        Class of the object; without it, a star.
    **values : object
        {name: value}: the columns of `catalog.table`, in the units there, and names of your own.

    Raises
    ------
    InputError
        For an unknown type.

    Examples
    --------
    >>> from csstsim.catalog.mock_object import MockObject
    >>> star = MockObject(id=1, type="star", ra=10.0, dec=-2.0, teff=5800.0, spectrum="g2v.fits")
    >>> star.position, star.pmra, star.spectrum
    ((10.0, -2.0), 0.0, 'g2v.fits')
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
        """Return a row of an ObjectTable as an object, which shows later changes of the table's arrays.

        Parameters
        ----------
        table : ObjectTable
            The table.
        row : int
            Row number.

        Returns
        -------
        MockObject
            A view; no values are copied.
        """
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
        """'star', 'galaxy', 'quasar', 'asteroid' or 'satellite'; 'unknown' for any other obj_type."""
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
    """The rows of an ObjectTable as MockObjects, created on access."""

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
