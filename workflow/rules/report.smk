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
        mem_mb=2000,
        runtime=10,
    shell:
        'csstsim report "$CAMPAIGN" > {log:q} 2>&1'
