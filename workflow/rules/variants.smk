# The variants side by side, when all of them are finished.
rule variants:
    input:
        [
            file
            for run in (RUN, *VARIANTS.values())
            for kind in ("level0", "measure", "extract", "report")
            for file in kinds(run)[kind].files()
        ],
    output:
        str(RUN.paths.variants_page),
    log:
        f"{OUT}/logs/variants.log",
    resources:
        mem_mb=more(2000),
        runtime=more(10),
    shell:
        "csstsim variants {CAMPAIGN:q} > {log:q} 2>&1"
