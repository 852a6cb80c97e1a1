"""Opening the True Universe a campaign names: the embedded bricks, or a class of the user's."""

from csstsim.catalog.base import catalog_class


def open_catalog(config, region, brick_file, key):
    """Return the loaded catalogue of a region.

    config: config.CatalogConfig; region: base.Region (select.region_for); brick_file: brick number -> path; key: what
    embedded bricks are made for, {seed, universe, camera, lensing}. Raises InputError.
    """
    if config.kind == "embedded":
        from csstsim.catalog.embedded import EmbeddedCatalog

        return EmbeddedCatalog({"brick_file": brick_file, **key}, region)
    return catalog_class(config.kind)(config.options, region)
