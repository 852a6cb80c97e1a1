"""Names of the keywords of a FITS WCS, as in the headers of Level-0 files."""

import re

# Of the assembled frame, linear or with SIP polynomials
WCS = re.compile(r"WCSAXES|(CTYPE|CUNIT|CRVAL|CRPIX)[12]|CD[12]_[12]|LONPOLE|LATPOLE|RADESYS|(A|B|AP|BP)_(ORDER|\d_\d)")
# Of the frame and of its channels, A to P
ANY_WCS = re.compile(rf"({WCS.pattern}|WCSNAME)[A-P]?")
