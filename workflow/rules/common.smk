# Opens the campaign, which checks all its files. csstsim.stages.parts.rule_files has the inputs of jobs; the records of
# stages (csstsim.base.stage_records) have their outputs, memory and time.
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
from csstsim.campaign.checks import check_keep, check_maps
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.products import kinds, summary
from csstsim.campaign.running.job_log import ERROR
from csstsim.campaign.running.node_scratch import node_scratch
from csstsim.campaign.running.one_by_one import (
    failed_since_start,
    remove_second_names,
    start_workflow,
)
from csstsim.campaign.variants import variant_file
from csstsim.io.level0_names import FORMS
from csstsim.io.output_owner import claim_output
from csstsim.stages.parts.rule_files import RuleFiles, by_exposure, of_exposure

KEYS = "campaign", "chips", "scratch"  # of --config
MAIN = (
    workflow.modifier.is_main_snakefile()
)  # False: included for a variant, named by the key `variant`
for key in config:
    if key not in KEYS and (
        MAIN or key != "variant"
    ):  # a misspelt key would run the demo
        raise WorkflowError(f"--config {key}: unknown; allowed: {', '.join(KEYS)}")
# {value of `chips`: file of rules}
JOB_OF = {"stages": "stages", "whole": "chip", "exposure": "exposure"}
CHIPS_AS = str(config.get("chips", "stages"))  # str: YAML may give any type
if CHIPS_AS not in JOB_OF:
    raise WorkflowError(f"chips: {CHIPS_AS}; allowed: {', '.join(JOB_OF)}")
# An absolute path, because Snakemake identifies a product by the text of its path
CAMPAIGN = config.get("campaign", "config/campaign.yaml")
if not isinstance(CAMPAIGN, str):  # Snakemake converts numbers and empty values
    print(
        f"{ERROR} --config campaign: not a file (got {CAMPAIGN}); allowed: the name of a campaign's YAML file",
        file=sys.stderr,
    )
    sys.exit(2)
CAMPAIGN = os.path.abspath(CAMPAIGN)
if not MAIN:
    CAMPAIGN = str(variant_file(CAMPAIGN, config["variant"]))

atexit.register(gc.freeze)  # as for the commands (csstsim.command_line.group)
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
        message = (
            "a variant is simulated with its base; give the campaign file without @"
        )
        raise InputError(message, file=CAMPAIGN)
    VARIANTS = {run.variant: run for run in RUN.variants}
    check_keep(RUN, CHIPS_AS, "scratch" in config)
    if workflow.is_main_process:  # find faults of the catalogue here, not in a rule
        RUN.open_truth()
        check_maps({job.chip.id: job.chip for job in RUN.jobs}.values(), read=True)
    _ = RUN.recipes.psf
    FILES = RuleFiles(RUN, ancient, main=workflow.is_main_process)
except CsstsimError as error:
    print(f"{ERROR} {with_page(error)}", file=sys.stderr)
    sys.exit(2)
OUT = str(RUN.paths.output)
BEGINNING = FORMS[RUN.config.level0_names].beginning
kept = (
    (lambda path: path) if RUN.config.keep == "light" else temp
)  # for the products of render


def take_folders():
    """Claim the output folders of the campaign and its variants before the first job, and check that they are writable."""
    try:
        for run in (RUN, *VARIANTS.values()):
            claim_output(run)
            start_workflow(run)
    except CsstsimError as error:
        raise WorkflowError(str(error)) from None


# Patterns of the slitless (exposure, chip) pairs, whose truth lists each order. Without such pairs they match nothing.
DISPERSED = by_exposure(RUN.slitless_jobs)
NONE = {"none": ["none"]}
SPECTRA_OBSID = "|".join(sorted(DISPERSED or NONE))
SPECTRA_CHIP = "|".join(sorted(set().union(*(DISPERSED or NONE).values())))

# One thread per process: chips run in parallel, and BLAS threads would compete for the cores.
LIBRARIES = "OMP", "OPENBLAS", "MKL", "NUMBA"
shell.prefix(
    f"export PATH={shlex.quote(os.path.dirname(sys.executable))}:$PATH "  # this csstsim before other installed ones
    + f"CSSTSIM_SCRATCH={shlex.quote(SCRATCH or str((RUN.base or RUN).paths.output))} "
    + " ".join(f"{library}_NUM_THREADS=1" for library in LIBRARIES)
    + "; "
)


def more(amount):
    """Return an amount that is multiplied by the number of the attempt, for jobs that lacked memory or time."""
    return lambda wildcards, attempt: amount * attempt


def memory(stage):
    """Return the memory in a stage's record [MB]."""
    return more(STAGES[stage].memory_mb)


def minutes(*stages):
    """Return the time of stages that run one after the other, from their records [min]."""
    return more(sum(FILES.minutes(stage) for stage in stages))


wildcard_constraints:
    obsid=r"\d{9,14}",
    chip=r"\d{2}",
    pix=r"\d+",
    dir=r"\d+",
    name=BEGINNING,
