"""Hydrodynamic coefficients of a torpedo-shaped vehicle from its dimensions."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Coefficients:
    """Coefficients of an axisymmetric hull with four equal stern fins, SI units, about the centre of buoyancy.

    Body axes: x forward, y starboard, z down. Signs and names are Prestero's (2001): a positive rudder angle pushes
    the stern to starboard, so that the vehicle turns to port, and a positive stern plane angle pushes the stern up, so
    that it dives.
    """

    # Added mass: force or moment per acceleration.
    X_udot: float
    Y_vdot: float
    Y_rdot: float
    Z_wdot: float
    Z_qdot: float
    K_pdot: float
    M_wdot: float
    M_qdot: float
    N_vdot: float
    N_rdot: float
    # Drag: per velocity times its size, e.g. Y_vv v |v|.
    X_uu: float
    Y_vv: float
    Y_rr: float
    Z_ww: float
    Z_qq: float
    K_pp: float
    M_ww: float
    M_qq: float
    N_vv: float
    N_rr: float
    # Lift of hull and centred fins: per |u| and velocity, e.g. Y_uv |u| v; without what added mass gives.
    Y_uv: float
    Y_ur: float
    Z_uw: float
    Z_uq: float
    M_uw: float
    M_uq: float
    N_uv: float
    N_ur: float
    # Fins: per u |u| and angle.
    Y_uudr: float
    N_uudr: float
    Z_uuds: float
    M_uuds: float
