"""python -m base_station"""

import sys

try:
    from base_station.cli import main
except ModuleNotFoundError as error:
    sys.exit(
        f"base-station: {error.name} is not installed for this Python: run scripts/setup, then .venv/bin/base-station."
    )

sys.exit(main())
