# The page that compares the variants, after all of them are finished.
rule variants:
    input:
        [
            file
            for run in (RUN, *VARIANTS.values())
            for kind in STAGES["variants"].inputs
            for file in kinds(run)[kind].files()
        ],
    output:
        str(RUN.paths.variants_page),
    log:
        f"{OUT}/logs/variants.log",
    resources:
        mem_mb=memory("variants"),
        runtime=minutes("variants"),
    shell:
        "csstsim variants {CAMPAIGN:q} > {log:q} 2>&1"
