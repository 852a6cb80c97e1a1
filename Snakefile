# The whole chain: survey table -> Level-0 files and truth -> brick catalogues -> report.
# Another campaign: snakemake --profile profiles/default --config campaign=config/c9_w1.yaml


include: "workflow/rules/common.smk"
include: "workflow/rules/truth.smk"
include: "workflow/rules/psf.smk"
include: f"workflow/rules/{JOB_OF[CHIPS_AS]}.smk"
include: "workflow/rules/look.smk"
include: "workflow/rules/masters.smk"
include: "workflow/rules/bricks.smk"
include: "workflow/rules/calibrate.smk"
include: "workflow/rules/report.smk"


rule all:
    default_target: True
    input:
        first_picture(),
        [made(rule) for rule, kind in MADE.items() if kind.target],


onstart:
    take_folder()


onsuccess:
    if workflow.is_main_process:
        remove_left(OUT)
        forget(RUN)
        print(summary(RUN, MADE))
