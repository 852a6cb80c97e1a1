# Opens the campaign, which checks every file of it. What a job reads: csstsim.stages.parts.rule_files; what it writes and
# may use: the stage's record, csstsim.base.stage_records.
import atexit
import gc
import os
import shlex
import shutil
import sys

from csstsim.base.errors import CsstsimError, InputError
from csstsim.base.files.atomic import remove_left
from csstsim.base.help_page import with_page
from csstsim.base.stage_records import STAGES
from csstsim.campaign.checks import check_kept, check_maps
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.products import kinds, summary
from csstsim.campaign.running.job_log import ERROR
from csstsim.campaign.running.node_scratch import node_scratch
from csstsim.campaign.running.one_by_one import failed_since, forget, started
from csstsim.campaign.variants import variant_file
from csstsim.io.level0_names import FORMS
from csstsim.io.output_owner import claim_output
from csstsim.stages.parts.rule_files import RuleFiles, by_exposure, of_exposure

KEYS = "campaign", "chips", "scratch"  # of --config
MAIN = (
    workflow.modifier.is_main_snakefile()
)  # else of a variant, named by the key `variant`
for key in config:
    if key not in KEYS and (
        MAIN or key != "variant"
    ):  # a slip of the pen would run the demo
        raise WorkflowError(f"--config {key}: unknown; allowed: {', '.join(KEYS)}")
JOB_OF = {"stages": "stages", "whole": "chip", "exposure": "exposure"}  # rules
CHIPS_AS = str(config.get("chips", "stages"))  # a YAML file may hold anything
if CHIPS_AS not in JOB_OF:
    raise WorkflowError(f"chips: {CHIPS_AS}; allowed: {', '.join(JOB_OF)}")
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
    CAMPAIGN = str(variant_file(CAMPAIGN, config["variant"]))

atexit.register(gc.freeze)  # as of the commands (csstsim.command_line.group)
try:
    SCRATCH = (
        node_scratch(config["scratch"], on_node=workflow.remote_exec)
        if "scratch" in config
        else None
    )
    if SCRATCH and workflow.remote_exec:
        atexit.register(shutil.rmtree, SCRATCH, ignore_errors=True)
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
    FILES = RuleFiles(RUN, ancient, main=workflow.is_main_process)
except CsstsimError as error:
    print(f"{ERROR} {with_page(error)}", file=sys.stderr)
    sys.exit(2)
OUT = str(RUN.paths.output)
BEGINNING = FORMS[RUN.config.level0_names].beginning
kept = (lambda path: path) if RUN.config.keep == "light" else temp  # what render makes


def take_folders():
    """Before the first job: the output folders are this campaign's and its variants', and can be written."""
    try:
        for run in (RUN, *VARIANTS.values()):
            claim_output(run)
            started(run)
    except CsstsimError as error:
        raise WorkflowError(str(error)) from None


# The (exposure, chip) pairs whose truth is kept order by order, as patterns; no pair: patterns that nothing meets.
DISPERSED = by_exposure(RUN.slitless_jobs)
NONE = {"none": ["none"]}
SPECTRA_OBSID = "|".join(sorted(DISPERSED or NONE))
SPECTRA_CHIP = "|".join(sorted(set().union(*(DISPERSED or NONE).values())))

# One thread a process: parallelism is over chips. Hidden BLAS threads would fight over the cores.
LIBRARIES = "OMP", "OPENBLAS", "MKL", "NUMBA"
shell.prefix(
    f"export PATH={shlex.quote(os.path.dirname(sys.executable))}:$PATH "  # this csstsim, whatever else is installed
    + f"CSSTSIM_SCRATCH={shlex.quote(SCRATCH or str((RUN.base or RUN).paths.output))} "
    + " ".join(f"{library}_NUM_THREADS=1" for library in LIBRARIES)
    + "; "
)


def more(amount):
    """A job that failed for memory or time is given twice as much, then thrice."""
    return lambda wildcards, attempt: amount * attempt


def memory(stage):
    """The memory of a stage's record [MB]."""
    return more(STAGES[stage].memory_mb)


def minutes(*stages):
    """The time of the records of stages that run one after the other [min]."""
    return more(sum(FILES.minutes(stage) for stage in stages))


wildcard_constraints:
    obsid=r"\d{9,14}",
    chip=r"\d{2}",
    pix=r"\d+",
    dir=r"\d+",
    name=BEGINNING,
