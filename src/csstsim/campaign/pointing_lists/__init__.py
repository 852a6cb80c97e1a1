"""Import of other people's lists of pointings as survey tables: `csstsim import-pointings`.

astropy does the part that it has: FITS tables, headings of ECSV, units, sexagesimal angles, coordinate frames and time
scales. Three parts stay csstsim's own. Rows of text are split here, because astropy refuses a complete file for one
wrong row. Numbers are converted cell by cell, because each row is refused by itself, with its reason. Days of JD and
MJD are decimal numbers, because a JD in double precision is off by 40 microseconds.
"""
