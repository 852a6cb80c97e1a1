rule report:
    input:
        FILES.made("merge"),
        FILES.made("validate"),
        FILES.made("extract"),
        FILES.made("level0"),
    output:
        FILES.made("report") or f"{OUT}/report/index.html",
    log:
        f"{OUT}/logs/report.log",
    resources:
        mem_mb=more(2000),
        runtime=more(10),
    shell:
        "csstsim report {CAMPAIGN:q} > {log:q} 2>&1"
