"""The stages of the workflow, one record for each.

A stage is a rule of Snakemake, a command of `csstsim` and a function in csstsim.stages, all with the name of the
record. The record states its inputs, its products, the units for which it runs, and its memory and time. The records
are used by the workflow, `plan`, `status`, `verify`, the help, the paths and the recipes. docs/extension_points.md
explains how to add a stage.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from collections.abc import Mapping

SECTION = "Stages of the workflow, one job each"  # sections of the help
LOOK = "Look"
ONE_CHIP = "Make a chip"


@dataclass(frozen=True)
class Product:
    """One file that a stage writes for each chip, exposure, exposure and chip, or brick.

    path: below the output folder, with the words of the stage's unit in braces: obsid and chip; obsid; chip; pix and
    dir.
    {stem} is the name of a Level-0 file (io.level0_names). only: "orders": for slitless jobs, whose truth lists each
    order; "cat": in campaigns with `cat` in `truth`; "joint": with measurement.joint.
    """

    name: str  # argument of io.paths.Paths.find
    path: str
    only: Literal["", "orders", "cat", "joint"] = ""


@dataclass(frozen=True)
class Stage:
    """One stage of the workflow.

    unit: the unit of one run; "job" is one chip in one exposure, "exposure" all chips of one. made_for: the property of
    campaign.opened.OpenCampaign that lists all units. products: `csstsim status` counts the first one.
    """

    name: str
    unit: Literal["chip", "job", "exposure", "brick", "campaign"]
    made_for: str
    inputs: tuple[str, ...]  # stages whose products it reads
    products: tuple[Product, ...]
    title: str  # of the products, in `csstsim status`
    memory_mb: int  # limit of a job; twice as much after a failure
    minutes: int  # limit of a job; twice as many after a failure
    # limits in campaigns of a fidelity, or with a user's catalogue ("own")
    minutes_in: Mapping[str, int] = field(default_factory=dict)
    costs: tuple[str, ...] = ()  # keys in config/costs.yaml: for all jobs, or for imaging and for slitless chips
    section: str = SECTION  # of `csstsim --help`
    summary: str = ""  # in the last message of the workflow; {n}: number of products, {s}: plural, {truth}: with truth
    kept: Literal["yes", "light", "no"] = "yes"  # light: only with `keep: light`; no: removed after use
    target: bool = True  # made again if it is missing from a finished campaign; False: only if a job needs it
    layered: bool = False  # takes time only for exposures with layers in this stage
    recipe: str = ""  # the stage whose recipe its products record; "": a digest of their own, or none
    of_base: Literal["", "file", "copy"] = ""  # a variant uses, or copies, an equal product of its base
    exposure_rule: str = ""  # the rule that runs it for all chips of an exposure in one process
    instead_of: str = ""  # the stage whose products it writes, in one process with the stages before it


_JOB = "{obsid}_{chip}"
_BRICK = "dataset/Norder=8/Dir={dir}/Npix={pix}.parquet"
_LEVEL0 = (
    Product("level0", "level0/{obsid}/{stem}.fits"),
    Product("level0_truth", "level0/{obsid}/{stem}.truth.parquet"),
    Product("level0_cat", "level0/{obsid}/{stem}.cat", only="cat"),
    Product("level0_orders", "level0/{obsid}/{stem}.orders.parquet", only="orders"),
)

_ALL = (
    Stage(
        name="truth",
        unit="brick",
        made_for="sky_bricks",
        inputs=(),
        products=(Product("truth", f"truth/{_BRICK}"),),
        title="truth bricks",
        memory_mb=1500,
        minutes=2,
        costs=("truth",),
        target=False,  # a new brick would be newer than all chips, which would be made again
        of_base="file",
    ),
    Stage(
        name="psf",
        unit="chip",
        made_for="sky_chips",
        inputs=(),
        products=(Product("psf", "psf/chip_{chip}.h5"), Product("psf_tables", "psf/chip_{chip}_tables.h5")),
        title="PSF sets",
        memory_mb=1500,
        minutes=5,
        costs=("psf",),
        target=False,  # as for truth
        of_base="file",
    ),
    Stage(
        name="select",
        unit="job",
        made_for="science_jobs",
        inputs=("truth",),
        products=(Product("select.parquet", f"chips/{_JOB}/select.parquet"),),
        title="objects of chips",
        memory_mb=1500,
        minutes=3,
        minutes_in={"own": 60},  # a user's catalogue returns spectra one by one
        costs=("select", "select_spectra"),
        kept="no",
        recipe="select",
        of_base="file",
    ),
    Stage(
        name="render",
        unit="job",
        made_for="jobs",
        inputs=("select", "psf"),
        products=(
            Product("render.fits", f"chips/{_JOB}/render.fits"),
            Product("drawn.parquet", f"chips/{_JOB}/drawn.parquet"),
            Product("orders.parquet", f"chips/{_JOB}/orders.parquet", only="orders"),
        ),
        title="light of chips",
        memory_mb=3000,
        minutes=4,
        minutes_in={"noise_free": 45, "reference": 700},
        costs=("render", "render_spectra"),
        summary="light of {n} chip{s} in chips/",
        kept="light",
        layered=True,
        recipe="render",
        of_base="file",
    ),
    Stage(
        name="readout",
        unit="job",
        made_for="jobs",
        inputs=("render",),
        products=(Product("readout.fits", f"chips/{_JOB}/readout.fits"),),
        title="images before digitisation",
        memory_mb=1500,
        minutes=2,
        costs=("readout",),
        kept="no",
        layered=True,
        recipe="readout",
    ),
    Stage(
        name="level0",
        unit="job",
        made_for="jobs",
        inputs=("render", "readout"),
        products=_LEVEL0,
        title="Level-0 files",
        memory_mb=1500,
        minutes=2,
        costs=("level0", "level0_spectra"),
        summary="{n} Level-0 file{s}{truth} in level0/",
        layered=True,
        recipe="level0",
        of_base="copy",
    ),
    Stage(
        name="chip",
        unit="job",
        made_for="jobs",
        inputs=("truth", "psf"),
        products=_LEVEL0,
        title="Level-0 files",
        memory_mb=3500,
        minutes=4,  # in addition to those of select and render
        costs=("chip", "chip_spectra"),
        section=ONE_CHIP,
        recipe="level0",
        of_base="copy",
        exposure_rule="exposure",
        instead_of="level0",
    ),
    Stage(
        name="masters",
        unit="chip",
        made_for="calibration_jobs",
        inputs=("level0",),
        products=(Product("masters", "masters/chip_{chip}.fits"),),
        title="masters",
        memory_mb=3500,
        minutes=8,
        costs=("masters",),
        summary="masters of {n} chip{s} in masters/",
    ),
    Stage(
        name="calibrate",
        unit="job",
        made_for="calibrated_jobs",
        inputs=("level0", "psf"),
        products=(Product("calibrated", f"calibrated/{_JOB}.fits"),),
        title="calibrated images",
        memory_mb=2500,
        minutes=3,
        costs=("calibrate",),
        summary="calibrated images of {n} chip{s} in calibrated/",
        recipe="measure",
    ),
    Stage(
        name="measure",
        unit="job",
        made_for="imaging_jobs",
        inputs=("level0", "psf"),
        products=(
            Product("measure", f"measure/{_JOB}.parquet"),
            Product("residual", f"measure/{_JOB}.residual.fits", only="joint"),
        ),
        title="measured tables",
        memory_mb=3500,
        minutes=4,
        costs=("measure",),
        recipe="measure",
        of_base="copy",
        exposure_rule="measure_exposure",
    ),
    Stage(
        name="extract",
        unit="job",
        made_for="slitless_jobs",
        inputs=("level0", "psf"),
        products=(
            Product("spectra", f"spectra/{_JOB}.parquet"),
            Product("spectra_figure", f"spectra/{_JOB}.png"),
            Product("lines", f"spectra/{_JOB}_lines.parquet"),
        ),
        title="spectra",
        memory_mb=2500,
        minutes=4,
        costs=("extract",),
        summary="spectra of {n} chip{s} in spectra/",
        recipe="measure",
        of_base="copy",
        exposure_rule="extract_exposure",
    ),
    Stage(
        name="merge",
        unit="brick",
        made_for="merge_bricks",
        inputs=("measure",),
        products=(Product("merge", f"merge/{_BRICK}"),),
        title="merged bricks",
        memory_mb=2500,
        minutes=4,
        costs=("merge",),
        summary="merged catalogues of {n} brick{s} in merge/",
    ),
    Stage(
        name="validate",
        unit="brick",
        made_for="merge_bricks",
        inputs=("level0", "measure", "merge"),
        products=(Product("validate", "validate/{pix}.json"), Product("validate_figure", "validate/{pix}.png")),
        title="validated bricks",
        memory_mb=4000,
        minutes=4,
        costs=("validate",),
    ),
    Stage(
        name="report",
        unit="campaign",
        made_for="reports",
        inputs=("level0", "extract", "merge", "validate"),
        products=(Product("report", "report/index.html"), Product("verdict", "report/verdict.json")),
        title="report",
        memory_mb=2000,
        minutes=10,
        costs=("report",),
        section=LOOK,
        summary="the report: report/index.html",
    ),
    Stage(
        name="variants",
        unit="campaign",
        made_for="comparisons",
        inputs=("level0", "measure", "extract", "report"),
        products=(Product("variants_page", "report/variants.html"),),
        title="comparison of variants",
        memory_mb=2000,
        minutes=10,
        section=LOOK,
        summary="the variants side by side: report/variants.html",
    ),
)

STAGES = {stage.name: stage for stage in _ALL}  # in the order of the workflow
PRODUCTS = {product.name: product for stage in _ALL for product in stage.products}
STAGE_OF = {product.name: stage for stage in reversed(_ALL) if not stage.instead_of for product in stage.products}
CHIP_STAGES = ("select", "render", "readout", "level0")  # one process each
