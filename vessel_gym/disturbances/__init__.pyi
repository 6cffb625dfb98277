from vessel_gym.disturbances.air import Air as Air
from vessel_gym.disturbances.disturbance import Disturbance as Disturbance
from vessel_gym.disturbances.fault import Fault as Fault
from vessel_gym.disturbances.sea import Sea as Sea
from vessel_gym.disturbances.seaway import BandedSeaway as BandedSeaway
from vessel_gym.disturbances.seaway import Seaway as Seaway
from vessel_gym.disturbances.water import SurfaceWater as SurfaceWater
from vessel_gym.disturbances.water import Water as Water
