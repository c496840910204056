"""python -m base_station"""

import sys

from base_station.cli import main

sys.exit(main())
