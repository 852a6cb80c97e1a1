# Opens the campaign (which checks every file of it) and answers the rules' questions; the only Python.
import atexit
import gc
import os
import shlex
import shutil
import sys
from types import SimpleNamespace

from csstsim.base.files.atomic import remove_left
from csstsim.base.help_page import with_page
from csstsim.campaign.checks import check_kept, check_maps
from csstsim.campaign.running.job_log import ERROR
from csstsim.campaign.running.one_by_one import apart, failed_since, forget, started
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.products import kinds, summary
from csstsim.campaign.variants import named
from csstsim.base.errors import CsstsimError, InputError
from csstsim.io.level0_names import FORMS
from csstsim.io.output_owner import claim_output
from csstsim.stages.parts.redraw import may_redraw
from csstsim.optics.psf.sampling import psf_cube

KEYS = "campaign", "chips", "scratch"  # of --config
MAIN = (
    workflow.modifier.is_main_snakefile()
)  # else of a variant, named by the key `variant`
for key in config:
    if key not in KEYS and (
        MAIN or key != "variant"
    ):  # a slip of the pen would run the demo
        raise WorkflowError(f"--config {key}: unknown; allowed: {', '.join(KEYS)}")
atexit.register(gc.freeze)  # as of the commands (csstsim.command_line.group)
# Snakemake knows a product by the text of its path: one text from wherever the campaign is named
CAMPAIGN = config.get("campaign", "config/campaign.yaml")
if not isinstance(CAMPAIGN, str):  # Snakemake reads numbers and nothing as such
    print(
        f"{ERROR} --config campaign: not a file (got {CAMPAIGN}); allowed: the name of a campaign's YAML file",
        file=sys.stderr,
    )
    sys.exit(2)
CAMPAIGN = os.path.abspath(CAMPAIGN)
if not MAIN:
    CAMPAIGN = str(named(CAMPAIGN, config["variant"]))


def node_scratch():
    """A cluster job's folder on its node's own disk, or None. The head has no such folder: it sees no intermediate."""
    if "scratch" not in config:
        return None
    disk = os.path.expandvars(str(config["scratch"]))
    if workflow.remote_exec and not os.path.isdir(disk):
        raise WorkflowError(
            f"scratch: {config['scratch']}: no such folder on {os.uname().nodename}"
        )
    return os.path.join(disk, f"csstsim_{os.environ.get('SLURM_JOB_ID', 'head')}")


SCRATCH = node_scratch()
if SCRATCH and workflow.remote_exec:
    atexit.register(shutil.rmtree, SCRATCH, ignore_errors=True)

CHIPS_AS = str(config.get("chips", "stages"))  # a YAML file may hold anything
try:
    RUN = OpenCampaign(CAMPAIGN, scratch=SCRATCH)
    if MAIN and RUN.variant:
        message = "a variant is made with its base; name the campaign without @"
        raise InputError(message, file=CAMPAIGN)
    VARIANTS = {run.variant: run for run in RUN.variants}
    check_kept(RUN, CHIPS_AS, "scratch" in config)
    if workflow.is_main_process:  # faults of the catalogue are met here, not in a rule
        RUN.open_truth()
        check_maps({job.chip.id: job.chip for job in RUN.jobs}.values(), read=True)
    _ = RUN.recipes.psf
    JOBS = {(job.obsid, f"{job.chip.id:02d}"): job for job in RUN.jobs}
except CsstsimError as error:
    print(f"{ERROR} {with_page(error)}", file=sys.stderr)
    sys.exit(2)
JOB_OF = {"stages": "stages", "whole": "chip", "exposure": "exposure"}  # rules
if CHIPS_AS not in JOB_OF:
    raise WorkflowError(f"chips: {CHIPS_AS}; allowed: {', '.join(JOB_OF)}")
OUT = str(RUN.paths.output)
NAMES = FORMS[RUN.config.level0_names]
ENDING = NAMES.ending
CHIPS = str(RUN.paths.chips)
kept = (lambda path: path) if RUN.config.keep == "light" else temp  # what render makes


MADE = kinds(RUN)

# The truth as text beside a Level-0 file, where the campaign asks for it
CAT = (
    [f"{OUT}/level0/{{obsid}}/{{name}}_{{obsid}}_{{chip}}_{ENDING}.cat"]
    if "cat" in RUN.config.truth
    else []
)


def made(rule, some=None):
    """The files that a rule makes for some jobs, chips or bricks, or for all."""
    return MADE[rule].files(some)


def targets(run):
    """All files that a campaign is to have in the end."""
    return [
        file for kind in kinds(run).values() if kind.target for file in kind.files()
    ]


def take_folders():
    """Before the first job: the output folders are this campaign's and its variants', and can be written."""
    try:
        for run in (RUN, *VARIANTS.values()):
            claim_output(run)
            started(run)
    except CsstsimError as error:
        raise WorkflowError(str(error)) from None


# The (exposure, chip) pairs whose truth is kept order by order, as patterns; no pair: patterns that nothing meets.
SPECTRA_OBSID = "|".join(sorted({j.obsid for j in RUN.slitless_jobs})) or "none"
SPECTRA_CHIP = (
    "|".join(sorted({f"{j.chip.id:02d}" for j in RUN.slitless_jobs})) or "none"
)

# One thread a process: parallelism is over chips. Hidden BLAS threads would fight over the cores.
LIBRARIES = "OMP", "OPENBLAS", "MKL", "NUMBA"
shell.prefix(
    f"export PATH={shlex.quote(os.path.dirname(sys.executable))}:$PATH "  # this csstsim, whatever else is installed
    + f"CSSTSIM_SCRATCH={shlex.quote(SCRATCH or str((RUN.base or RUN).paths.output))} "
    + " ".join(f"{library}_NUM_THREADS=1" for library in LIBRARIES)
    + "; "
)


# Minutes of the two stages that depend on the campaign
SELECTING = 3 if RUN.embedded else 60  # spectra of a user's catalogue come one by one
RENDERING = {"noise_free": 30, "reference": 600}.get(RUN.config.fidelity, 4)


def more(amount):
    """A job that failed for memory or time is given twice as much, then thrice."""
    return lambda wildcards, attempt: amount * attempt


wildcard_constraints:
    obsid=r"\d{9,14}",
    chip=r"\d{2}",
    pix=r"\d+",
    dir=r"\d+",
    name=NAMES.beginning,


def shared(files):
    """Truth bricks or PSF sets. If campaigns share them, the youngest link sets their date, which then says nothing."""
    return [ancient(file) for file in files] if RUN.config.share else files


def truth_of(wildcards):
    """The truth bricks whose objects may reach a chip's window, for exposures that see the sky."""
    if not RUN.embedded or RUN.pointings[wildcards.obsid].type != "SCIE":
        return []
    return shared(
        made("truth", RUN.truth_bricks(JOBS[wildcards.obsid, wildcards.chip]))
    )


def library_of(wildcards):
    """The file of a chip in a library of PSFs, where the campaign takes its sets from one."""
    library = RUN.psf_library
    return str(psf_cube(library, int(wildcards.chip))) if library else []


def psf_of(wildcards):
    """The PSF set of a chip and its tables, for exposures that see the sky."""
    if RUN.pointings[wildcards.obsid].type != "SCIE":
        return []
    return shared(made("psf", [int(wildcards.chip)]))


def between(wildcards, name):
    """A file that one stage of a chip hands to another."""
    return str(RUN.paths.stage(wildcards.obsid, int(wildcards.chip), name))


def objects_of(wildcards):
    """The selected objects and the PSF."""
    psf = psf_of(wildcards)
    return psf and [
        between(wildcards, "select.parquet"),
        *psf,
        *light_of_base(wildcards),
    ]


def light_of_base(wildcards):
    """The kept light of the base, where a variant's differs by objects at most."""
    job = JOBS[wildcards.obsid, wildcards.chip]
    if not (RUN.base and RUN.base.config.keep == "light" and may_redraw(RUN, job)):
        return []
    return made_by(RUN.base, "render", job)


def stage_before(stage):
    """The input function of a stage: the product of the stage before it, if that stage has layers."""

    def product(wildcards):
        has = RUN.has_stage(RUN.pointings[wildcards.obsid], stage)
        return between(wildcards, f"{stage}.fits") if has else []

    return product


def drawn_before(wildcards):
    """The table of drawn objects, and that of their orders, where there is a render stage."""
    if not RUN.has_stage(RUN.pointings[wildcards.obsid], "render"):
        return []
    spectra = RUN.has_orders(JOBS[wildcards.obsid, wildcards.chip])
    names = ("drawn.parquet", "orders.parquet") if spectra else ("drawn.parquet",)
    return [between(wildcards, name) for name in names]


def made_by(run, rule, job):
    """The files that a rule makes for a job in another campaign of the graph."""
    return kinds(run)[rule].files([job])


def unless_equal(rule, *functions):
    """The input function of a rule: what some functions return, or the base's products of the rule, if a variant's are equal."""
    stage = "measure" if rule == "extract" else rule

    def files(wildcards):
        job = JOBS[wildcards.obsid, wildcards.chip]
        if RUN.in_base(*job.key, stage):
            return made_by(RUN.base, rule, job)
        found = [function(wildcards) for function in functions]
        return [
            file
            for some in found
            for file in ([some] if isinstance(some, str) else some)
        ]

    return files


def recipe(stage):
    """What decides what a stage makes of a chip: a change of it, and of nothing else, reruns the stage."""
    return lambda wildcards: RUN.recipe(JOBS[wildcards.obsid, wildcards.chip], stage)


def by_exposure(jobs):
    """{obsid: [chip, ...]} of jobs."""
    found = {}
    for job in jobs:
        found.setdefault(job.obsid, []).append(f"{job.chip.id:02d}")
    return found


def groups_of(jobs, rule):
    """[{obsid: [chip, ...]}, ...] of jobs: all, but for chips that failed among others once, then each of these alone."""
    failed = apart(RUN, rule, start=workflow.is_main_process)
    alone = [job for job in jobs if job.key in failed]
    return [
        by_exposure(job for job in jobs if job.key not in failed),
        *(by_exposure([job]) for job in alone),
    ]


def groups_alike(jobs, rule, endings):
    """(number, chips_of, files, obsids, log) of each of the groups whose files are named alike (`named_alike`)."""
    number = 0
    for k, chips_of in enumerate(groups_of(jobs, rule)):
        for files, obsids in named_alike(chips_of, endings).items():
            yield number, chips_of, files, obsids, f"_{files[0][0]}" if k else ""
            number += 1


def named_alike(chips_of, endings):
    """{((chip, endings), ...): [obsid, ...]}: exposures whose files are named alike. endings(obsid, chip): a tuple."""
    found = {}
    for obsid, chips in chips_of.items():
        files = tuple((chip, endings(obsid, chip)) for chip in chips)
        found.setdefault(files, []).append(obsid)
    return found


def of_exposure(function, chips_of):
    """What `function` returns for each of some chips of an exposure, in one list."""

    def gathered(wildcards):
        found = []
        for chip in chips_of[wildcards.obsid]:
            place = SimpleNamespace(obsid=wildcards.obsid, chip=chip)
            found += [item for item in function(place) if item not in found]
        return found

    return gathered


def recipes_of(stage, chips_of):
    """The recipes of a stage for some chips of an exposure."""
    return of_exposure(lambda place: [recipe(stage)(place)], chips_of)


def options_of(files):
    """The options that name the chips of `named_alike` on the command line."""
    return " ".join(f"--chip {int(chip)}" for chip, _ in files)


def first_picture():
    """The picture of the first frame, in a list: no product, but made with them."""
    return [str(RUN.paths.look(*job.key)) for job in RUN.first_frames]


def level0_of(wildcards):
    return made("level0", [JOBS[wildcards.obsid, wildcards.chip]])[:1]


def with_truth(wildcards):
    """A Level-0 file, and the truth beside it."""
    return made("level0", [JOBS[wildcards.obsid, wildcards.chip]])


def measured_with(wildcards):
    """What a Level-0 file is measured with: the PSF set, master frames."""
    return [*shared(made("psf", [int(wildcards.chip)])[:1]), *masters_of(wildcards)]


def masters_of(wildcards):
    """The master frames a chip is measured with, of another campaign."""
    if RUN.config.measurement.calibration != "frames":
        return []
    return [str(RUN.masters(int(wildcards.chip)))]


def calibration_frames_of(wildcards):
    """The bias, dark and lamp exposures of a chip."""
    return made("level0", RUN.calibration_jobs[int(wildcards.chip)])


def on_brick(rule):
    """The products of a rule, of the frames on a brick."""
    return lambda wildcards: made(rule, RUN.merge_bricks[int(wildcards.pix)])


def merged(wildcards):
    return made("merge", [int(wildcards.pix)])
