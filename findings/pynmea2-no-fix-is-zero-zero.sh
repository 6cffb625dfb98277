#!/usr/bin/env bash
# One would expect None for the position of a GGA or RMC sentence without a fix (empty fields, as
# receivers send from power-up on and in outages). It is 0.0, 0.0, a valid place in the Gulf of
# Guinea, while altitude, speed and course are None (pynmea2 1.19.0, properties latitude and
# longitude; the README does not say so). Hurts who replays a receiver's log into a filter: an
# outage becomes a measurement thousands of kilometres off. Instead: NaN, which is missing here,
# wherever the field `lat` is empty, `gps_qual` is 0 (GGA) or `status` is V (RMC).
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install -qq --no-compile pynmea2==1.19.0

"$folder/env/bin/python" - <<'EOF'
from functools import reduce
from importlib.metadata import version

import pynmea2


def sentence(body):
    return f"${body}*{reduce(lambda a, c: a ^ ord(c), body, 0):02X}"


fix = pynmea2.parse(sentence("GPGGA,120000.00,0712.50,S,11245.25,E,1,08,1.1,4.2,M,30.1,M,,"))
gga = pynmea2.parse(sentence("GPGGA,120001.00,,,,,0,00,99.99,,,,,,"))
rmc = pynmea2.parse(sentence("GPRMC,120001.00,V,,,,,,,010126,,,N"))

print("pynmea2", version("pynmea2"))
print("GGA with a fix:   ", fix.latitude, fix.longitude, "altitude", fix.altitude)
print("GGA without a fix:", gga.latitude, gga.longitude, "altitude", gga.altitude,
      "quality", gga.gps_qual, "field", repr(gga.lat))
print("RMC without a fix:", rmc.latitude, rmc.longitude, "speed", rmc.spd_over_grnd,
      "course", rmc.true_course, "status", rmc.status)

assert abs(fix.latitude + 7.208333) < 1e-6 and abs(fix.longitude - 112.754167) < 1e-6
for lost in gga, rmc:
    assert (lost.latitude, lost.longitude) == (0.0, 0.0), "no fix is no longer 0, 0"
assert gga.altitude is None and gga.gps_qual == 0 and gga.lat == ""
assert rmc.spd_over_grnd is None and rmc.status == "V"
EOF
