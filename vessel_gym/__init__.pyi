from vessel_gym.contract import check_system as check_system
from vessel_gym.envs.own import model_of as model_of

__version__: str
