"""DAPPER: its first step, its averages, its transforms, and where its filters linearise."""

# /// script
# dependencies = ["DAPPER==1.7.1", "llvmlite==0.50.0", "numpy==2.4.6", "scipy==1.17.1"]
# ///

import dapper
import numpy as np
from case import COV, MEAN, A, C, Q, R, after, close, f, h, kf, pendulum, prior
from dapper import da_methods, mods
from dapper.da_methods.ensemble import EnKF_analysis, post_process

from estimators import LinearModel, NonlinearModel, make, rmse, run, smooth

members = np.random.default_rng(5).normal(size=(20, 2)) + MEAN


def f_slope(x, t, dt):
    bend = -0.5 * np.cos(x[0])
    return np.array([[1.0 + 0.5 * bend, 0.5], [bend, 1.0]])


def h_slope(x):
    return np.array([[np.cos(x[0]), 0.0], [-np.sin(x[0]), 0.0]])


def random(cov):
    return mods.GaussRV(C=cov, mu=np.zeros(2)) if cov.any() else 0


def experiment(linear, Q, R):
    """A hidden Markov model, its truth and its measurements."""
    move, see = {"model": lambda x, t, dt: f(x), "linear": f_slope}, {"model": h, "linear": h_slope}
    if linear:
        move = {"model": lambda x, t, dt: x @ A.T, "linear": lambda x, t, dt: A}
        see = {"model": lambda x: x @ C.T, "linear": lambda x: C}
    HMM = mods.HiddenMarkovModel(
        {"M": 2, "noise": random(Q)} | move,
        {"M": 2, "noise": random(R)} | see,
        mods.Chronology(1.0, dko=1, K=50, BurnIn=0),
        mods.GaussRV(C=COV, mu=MEAN),
    )
    dapper.set_seed(3)
    x, y = HMM.simulate()
    return HMM, x, np.stack([y[k] for k in range(50)])


def theirs(method, HMM, x, y):
    method.assimilate(HMM, x, y)
    return method.stats


def ensemble(filter):
    """A belief with the members above."""
    belief = filter.init(prior, rng=np.random.default_rng(0))
    return belief.replace(mean=members.mean(0), cov=np.cov(members.T), members=members.T)


# first step and averages
HMM, x, y = experiment(True, Q, R)
assert len(x) == len(y) + 1
xp = da_methods.ExtKF()
stats, ours = theirs(xp, HMM, x, y), after(kf, y)
close(stats.mu.a, ours.mean[1:])
stats.average_in_time()
error = ours.mean[1:] - x[1:]
close(xp.avrgs.err.rms.a.val, np.sqrt(np.square(error).mean(-1)).mean())
assert np.sqrt(np.square(rmse(ours.mean[1:], x[1:])).mean()) > 1.1 * xp.avrgs.err.rms.a.val

# linearisation
HMM, x, y = experiment(False, 0.1 * Q, 0.1 * R)
ours = after(make("ekf", pendulum), y)
close(theirs(da_methods.ExtRTS(), HMM, x, y).mu.a, ours.mean[1:])
assert np.abs(theirs(da_methods.ExtKF(), HMM, x, y).mu.a - ours.mean[1:]).max() > 0.1

# members
noise = random(0.1 * R)
for name, kind in ("etkf", "Sqrt"), ("enkf", "PertObs"):
    filter = make(name, pendulum, members=20, inflation=1.1, draws="independent")
    belief = filter.update(ensemble(filter), y[0], rng=np.random.default_rng(0))
    moved = post_process(EnKF_analysis(members.copy(), h(members), noise, y[0], kind), 1.1, False)
    close(moved.mean(0), belief.mean)
    if name == "etkf":
        close(moved, belief.members.T)

# smoothing of members
for linear, model in (
    (True, LinearModel(A, C, 0.0 * Q, R)),
    (False, NonlinearModel(f, h, 0.0 * Q, 0.1 * R)),
):
    filter, (HMM, x, y) = (
        make("etkf", model, draws="independent", members=20),
        experiment(linear, 0.0 * Q, model.R),
    )
    HMM.X0 = mods.RV(M=2, func=lambda N: members)
    ours = smooth(run(filter, ensemble(filter), y, rng=0, first=1)).mean
    close(theirs(da_methods.EnRTS("Sqrt", 20, DeCorr=1.0), HMM, x, y).mu.s, ours)
    if linear:
        close(theirs(da_methods.EnKS("Sqrt", 20, Lag=50), HMM, x, y).mu.s, ours)
