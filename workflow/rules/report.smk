rule report:
    input:
        merged_bricks,
        validated_bricks,
        spectra,
        level0_files,
    output:
        f"{OUT}/report/index.html",
        catalogue(),
        f"{OUT}/report/verdict.json",
    log:
        f"{OUT}/logs/report.log",
    benchmark:
        f"{OUT}/benchmarks/report.tsv"
    resources:
        mem_mb=more(2000),
        runtime=more(10),
    shell:
        'csstsim report "$CAMPAIGN" > {log:q} 2>&1'
