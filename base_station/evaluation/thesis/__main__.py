"""python -m base_station.evaluation.thesis: what scripts/reproduce-thesis runs."""

import sys

from base_station.evaluation.thesis.reproduce import main

sys.exit(main())
