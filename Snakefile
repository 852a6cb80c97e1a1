# The workflow: survey table -> Level-0 files and truth -> catalogues of bricks -> report.
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


# Variants of the campaign: the same rules for each, with other names.
for VARIANT in VARIANTS:
    MODULE, BEFORE = f"variant_{VARIANT}", f"{VARIANT}_"

    module:
        name: MODULE
        snakefile:
            os.path.join(workflow.current_basedir, "Snakefile")
        config:
            config | {"variant": VARIANT}

    use rule * from MODULE exclude all as BEFORE*


if VARIANTS:

    include: "workflow/rules/variants.smk"


rule all:
    default_target: True
    input:
        # the picture of the first frame, which is not a product
        [str(RUN.paths.look(*job.key)) for job in RUN.first_frames],
        [
            kind.files()
            for run in (RUN, *VARIANTS.values())
            for kind in kinds(run).values()
            if kind.target
        ],


onstart:
    take_folders()


onerror:
    if workflow.is_main_process:
        if any(failed_since_start(run) for run in (RUN, *VARIANTS.values())):
            print(
                "Chips that failed will be simulated in separate jobs. Run the same command again to finish all other "
                "products. `csstsim status` lists the failures. List chips that cannot be made in `select.missing`."
            )


onsuccess:
    if workflow.is_main_process:
        remove_left(OUT)
        for run in (RUN, *VARIANTS.values()):
            remove_second_names(run)
            print(summary(run, kinds(run)))
