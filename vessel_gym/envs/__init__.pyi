from pathlib import Path
from typing import Any

from vessel_gym.envs.own import register_environment as register_environment
from vessel_gym.envs.single import VesselEnv as VesselEnv
from vessel_gym.envs.vector import VesselVectorEnv as VesselVectorEnv

class AUVEnv(VesselEnv):
    def __init__(
        self, *arguments: Any, vessel: str | Path | None = None, **options: Any
    ) -> None: ...

class FixedWingEnv(VesselEnv):
    def __init__(
        self, *arguments: Any, vessel: str | Path | None = None, **options: Any
    ) -> None: ...

class ItsunusaAUVEnv(VesselEnv):
    def __init__(self, *arguments: Any, as_printed: bool = False, **options: Any) -> None: ...

class PunaUAVEnv(VesselEnv):
    def __init__(self, *arguments: Any, as_printed: bool = False, **options: Any) -> None: ...

class SegorogeniAUVEnv(VesselEnv):
    def __init__(self, *arguments: Any, as_printed: bool = False, **options: Any) -> None: ...

class ShipEnv(VesselEnv):
    def __init__(
        self, *arguments: Any, vessel: str | Path | None = None, **options: Any
    ) -> None: ...

class SigmaChannelEnv(VesselEnv): ...
class SigmaCorvetteEnv(VesselEnv): ...

class ThesisCorvetteEnv(VesselEnv):
    def __init__(self, *arguments: Any, as_printed: bool = False, **options: Any) -> None: ...

class AUVVectorEnv(VesselVectorEnv):
    def __init__(
        self, *arguments: Any, vessel: str | Path | None = None, **options: Any
    ) -> None: ...

class FixedWingVectorEnv(VesselVectorEnv):
    def __init__(
        self, *arguments: Any, vessel: str | Path | None = None, **options: Any
    ) -> None: ...

class ItsunusaAUVVectorEnv(VesselVectorEnv):
    def __init__(self, *arguments: Any, as_printed: bool = False, **options: Any) -> None: ...

class PunaUAVVectorEnv(VesselVectorEnv):
    def __init__(self, *arguments: Any, as_printed: bool = False, **options: Any) -> None: ...

class SegorogeniAUVVectorEnv(VesselVectorEnv):
    def __init__(self, *arguments: Any, as_printed: bool = False, **options: Any) -> None: ...

class ShipVectorEnv(VesselVectorEnv):
    def __init__(
        self, *arguments: Any, vessel: str | Path | None = None, **options: Any
    ) -> None: ...

class SigmaChannelVectorEnv(VesselVectorEnv): ...
class SigmaCorvetteVectorEnv(VesselVectorEnv): ...

class ThesisCorvetteVectorEnv(VesselVectorEnv):
    def __init__(self, *arguments: Any, as_printed: bool = False, **options: Any) -> None: ...
