"""Opening the catalogue that a campaign names: the embedded bricks, or a class of the user's."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from csstsim.base.digest import file_digest, module_digest
from csstsim.base.errors import InputError
from csstsim.base.files.relative_to_file import relative_to_file
from csstsim.base.help_page import explained
from csstsim.catalog.base import CatalogBase, Region, name_of, users_code

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from csstsim.base.types import PathLike
    from csstsim.campaign.sections import CatalogConfig

TABLE_KIND = "csstsim.catalog.own_table:TableCatalog"


def open_catalog(
    config: CatalogConfig, region: Region, brick_file: Callable[[int], PathLike], key: Mapping[str, Any]
) -> CatalogBase:
    """Return the loaded catalogue of a region.

    config: sections.CatalogConfig; region: base.Region (select.region_for); brick_file: brick number -> path; key: the
    inputs of embedded bricks (campaign.opened.OpenCampaign.universe_key). Raises InputError, also for exceptions of
    the user's own code.
    """
    if config.kind == "embedded":
        from csstsim.catalog.embedded import EmbeddedCatalog

        return EmbeddedCatalog({"brick_file": brick_file, "components": config.components, **key}, region)
    return make_catalog(catalog_class(config.kind), config.options, region)


@explained("catalogue")
def make_catalog(cls: type[CatalogBase], options: Mapping[str, Any], region: Region) -> CatalogBase:
    """Return `cls(options, region)`. Raises InputError for exceptions of the user's code, and if it sets no objs."""
    with users_code(f"{cls.__name__}.__init__"):
        catalog = cls(options, region)
    if not hasattr(catalog, "objs"):
        raise InputError("has no objs: __init__ must call super().__init__(options, region)", key=name_of(catalog))
    return catalog


def importable(folder: PathLike) -> None:
    """Let dotted paths name modules in a campaign's folder; modules of the environment come first."""
    folder = str(Path(folder).resolve())
    if folder not in sys.path:
        sys.path.append(folder)


def resolved_options(kind: str, options: Mapping[str, Any], file: Path) -> dict[str, Any]:
    """Return a class's options, with relative paths (CatalogBase.PATHS) resolved from the campaign's folder.

    Raises InputError for a class that cannot be used, and if its module hides one in the campaign's folder.
    """
    _not_hidden(kind.partition(":")[0].partition(".")[0], file)
    options = dict(options)
    for name in set(catalog_class(kind).PATHS).intersection(options):
        value = options[name]
        if isinstance(value, str | Path):
            options[name] = str(relative_to_file(file, value))
        elif isinstance(value, list):
            options[name] = [str(relative_to_file(file, path)) for path in value]
    return options


def _not_hidden(name: str, file: Path) -> None:
    """Raise InputError if the module `name` in a campaign's folder is hidden by another that was loaded."""
    folder = file.parent.resolve()
    loaded = getattr(sys.modules.get(name), "__file__", None)
    modules = [path for path in (folder / f"{name}.py", folder / name / "__init__.py") if path.is_file()]
    if modules and loaded and not Path(loaded).resolve().is_relative_to(folder):
        raise InputError(
            f"{loaded} was loaded under this name, not {modules[0]}",
            file=file,
            key="catalog.kind",
            value=name,
            allowed="another name for the module, or another process",
        )


@explained("catalogue")
def catalog_class(kind: str) -> type[CatalogBase]:
    """Return the CatalogBase class named 'module.path:ClassName'. Raises InputError if there is none."""
    module_name, colon, class_name = kind.partition(":")
    if not (colon and module_name and class_name):
        raise InputError("unknown catalogue", key="catalog.kind", value=kind, allowed="embedded, module.path:ClassName")
    try:
        with users_code(f"catalog.kind: importing {module_name}"):
            module = importlib.import_module(module_name)
    except InputError as error:
        missing = error.__cause__
        if isinstance(missing, ModuleNotFoundError) and f"{module_name}.".startswith(f"{missing.name}."):
            raise InputError(
                f"no module {missing.name!r} on the Python path", key="catalog.kind", value=kind
            ) from missing
        raise
    cls = getattr(module, class_name, None)
    if not (isinstance(cls, type) and issubclass(cls, CatalogBase)):
        classes = [
            name
            for name, member in vars(module).items()
            if isinstance(member, type) and issubclass(member, CatalogBase) and member is not CatalogBase
        ]
        allowed = ", ".join(classes) or None
        raise InputError("not a CatalogBase class of that module", key="catalog.kind", value=kind, allowed=allowed)
    return cls


def catalogue_digests(config: CatalogConfig) -> list[str | None]:
    """Return the digests of a user's catalogue: of its module, and of the files that its `files` names.

    config: sections.CatalogConfig. Raises InputError for a file that cannot be read.
    """
    cls = catalog_class(config.kind)
    with users_code(f"{config.kind}.files"):
        files = cls.files(config.options)
    try:
        return [module_digest(sys.modules[cls.__module__]), *map(file_digest, files)]
    except OSError as exc:
        message = f"cannot read the file: {exc.strerror}"
        raise InputError(message, file=exc.filename, key="catalog.options") from None
