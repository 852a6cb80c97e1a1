"""MockObject: one astronomical object, the paper's unit of input (section 4, Appendix A)."""

from collections.abc import Sequence

from csstsim.base.errors import InputError
from csstsim.catalog.table import COLUMNS, MAGNITUDE, OPTIONAL, TYPES


class MockObject:
    """One object; its values are attributes named as the columns of `catalog.table` (units there).

    Made from keywords by a catalogue of your own, `MockObject(id=1, type="star", ra=10.0, dec=-2.0,
    teff=5800, spectrum="g2v.fits")`, or as a view of a row of an ObjectTable, `MockObject.view(table, row)`.
    Names that are not columns (`spectrum`) are kept for your `load_sed`. Columns not given have their default.
    Raises InputError for an unknown type.
    """

    __slots__ = ("_columns", "_row")

    def __init__(self, *, type=None, **values):
        if type is not None:
            if type not in TYPES:
                raise InputError(
                    f"object {values.get('id')} is of unknown type", key="type", value=str(type),
                    allowed=", ".join(TYPES),
                )  # fmt: skip
            values["obj_type"] = TYPES.index(type)
        self._columns = {name: (value,) for name, value in values.items()}
        self._row = 0

    @classmethod
    def view(cls, table, row):
        """Return row `row` of an ObjectTable as an object; it sees later changes of the table's arrays."""
        self = cls.__new__(cls)
        self._columns, self._row = table, row
        return self

    def __getattr__(self, name):
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
    def type(self):
        """'star', 'galaxy' or 'quasar'; 'unknown' for any other obj_type."""
        return dict(enumerate(TYPES)).get(int(self.obj_type), "unknown")

    @property
    def position(self):
        """(ra, dec) [deg, ICRS]."""
        return self.ra, self.dec

    @property
    def values(self):
        """The object's values by name, without defaults."""
        return {name: self._columns[name][self._row] for name in self._columns}

    def __repr__(self):
        return f"MockObject({self.type} {self.id} at ra={self.ra}, dec={self.dec})"


class MockObjects(Sequence):
    """The rows of an ObjectTable as MockObjects, made when asked for."""

    def __init__(self, table):
        self._table = table

    def __len__(self):
        return len(self._table)

    def __getitem__(self, row):
        if isinstance(row, slice):
            return MockObjects(self._table.take(row))
        if not -len(self) <= row < len(self):
            raise IndexError(row)
        return MockObject.view(self._table, row)
