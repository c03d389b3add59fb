"""An unmodified MaskablePPO of sb3-contrib compared with the shipped policies, on a small team.

    pip install sb3-contrib
    python bench/peers/training.py [--seeds 3] [--steps 20480] [--record bench/records/training.json] [--figure FILE]

Each seed trains one network on `kitassist/Team-v0`. After every tenth of the steps it is evaluated on the same
episodes, with the same random numbers, as the shipped policies. The result is the discounted return with a 95 %
interval, over episodes for the shipped policies and over seeds for the network.
"""

from __future__ import annotations

import datetime
import subprocess
import sys
import time
from pathlib import Path

import click
import gymnasium
import numpy as np
from matplotlib.figure import Figure

import assist.interop.gymnasium  # noqa: F401  registers the environment
from assist import simulate
from assist.person.settings import Setting

ROOT = Path(__file__).resolve().parent.parent.parent
SETTING = Setting(c_suggest=0.2)
EPISODES, SEED, ENVS = 1000, 12345, 4
POLICIES = ("none", "reactive", "attention", "priority")
COLOURS = {"attention": "#0072B2", "priority": "#D55E00", "none": "#8C8C8C", "reactive": "#E69F00"}


def played(model: object, instance: str, humans: int) -> float:
    """Return the mean discounted return of a network's most likely actions, in the episodes of `simulate`."""
    many = gymnasium.make_vec("kitassist/Team-v0", num_envs=EPISODES, instance=instance, humans=humans, setting=SETTING)
    seen, _ = many.reset(seed=SEED)
    returns, going = np.zeros(EPISODES), np.ones(EPISODES, dtype=bool)
    for step in range(SETTING.max_steps):
        actions, _ = model.predict(seen, action_masks=seen["action_mask"].astype(bool), deterministic=True)
        seen, reward, terminated, truncated, _ = many.step(actions)
        returns += np.where(going, SETTING.gamma**step * reward, 0.0)
        going &= ~(terminated | truncated)
        if not going.any():
            break
    return float(returns.mean())


def trained(instance: str, humans: int, seed: int, steps: int) -> list[float]:
    """Train one network; return its value before training, and after every tenth of the steps."""
    from sb3_contrib import MaskablePPO
    from stable_baselines3.common.env_util import make_vec_env

    envs = make_vec_env(
        "kitassist/Team-v0", n_envs=ENVS, seed=seed,
        env_kwargs={"instance": instance, "humans": humans, "setting": SETTING},
    )  # fmt: skip
    model = MaskablePPO("MultiInputPolicy", envs, n_steps=2048 // ENVS, seed=seed, gamma=SETTING.gamma, device="cpu")
    found = [played(model, instance, humans)]
    for _ in range(10):
        model.learn(steps // 10, reset_num_timesteps=False)
        found.append(played(model, instance, humans))
        print(f"seed {seed}: {found[-1]:.3f}", flush=True)
    return found


def interval(values: np.ndarray) -> float:
    """Return half the width of Student's 95 % interval of a mean."""
    from scipy.stats import t

    return float(t.ppf(0.975, len(values) - 1) * values.std(ddof=1) / np.sqrt(len(values)))


@click.command()
@click.option("--instance", default="kitting/tiny", show_default=True)
@click.option("--humans", default=2, show_default=True)
@click.option("--seeds", type=click.IntRange(2), default=3, show_default=True)
@click.option("--steps", type=click.IntRange(100), default=20_480, show_default=True)
@click.option(
    "--record", type=click.Path(path_type=Path, dir_okay=False), help="Write the table for the documentation."
)
@click.option("--figure", type=click.Path(path_type=Path, dir_okay=False), help="Draw the curves.")
def main(instance: str, humans: int, seeds: int, steps: int, record: Path | None, figure: Path | None) -> None:
    """Train networks, and compare them with the shipped policies."""
    import torch

    torch.set_num_threads(1)
    pool = gymnasium.make("kitassist/Team-v0", instance=instance, humans=humans, setting=SETTING).unwrapped.pool
    episodes = {
        name: simulate(pool, name, humans=humans, episodes=EPISODES, seed=SEED).discounted_return for name in POLICIES
    }
    start = time.process_time()
    curves = np.array([trained(instance, humans, seed, steps) for seed in range(seeds)])
    seconds = (time.process_time() - start) / seeds
    rows = [[name, f"{r.mean():.2f} ± {interval(r):.2f}", f"{EPISODES} episodes"] for name, r in episodes.items()]
    for place, label in ((0, "before"), (5, f"after {steps // 2:,} steps"), (10, f"after {steps:,} steps")):
        values = curves[:, place]
        rows.append([f"MaskablePPO, {label}", f"{values.mean():.2f} ± {interval(values):.2f}", f"{seeds} seeds"])
    table = [["policy", "discounted return", "95 % interval over"], *rows]
    for row in table:
        print(" | ".join(row))
    print(f"{seconds:.0f} s of processor time for each seed")
    if record is not None:
        sys.path.insert(0, str(ROOT / "bench"))
        from tables import save

        arguments = f"--instance {instance} --humans {humans} --seeds {seeds} --steps {steps}"
        commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, cwd=ROOT)
        save(record, {
            "commands": [f"python bench/peers/training.py {arguments}"],
            "made": f"{datetime.date.today()}, {commit.stdout.strip()}",
            "seconds per seed": round(seconds), "curves": curves.round(4).tolist(),
            "returns": {name: round(float(r.mean()), 4) for name, r in episodes.items()}, "table": table,
        })  # fmt: skip
    if figure is not None:
        draw(curves, {name: float(r.mean()) for name, r in episodes.items()}, steps, figure)


def draw(curves: np.ndarray, shipped: dict[str, float], steps: int, file: Path) -> None:
    """Plot the learning curve of every seed, and the values of the shipped policies."""
    canvas = Figure(figsize=(6.4, 3.6), layout="constrained")
    axes = canvas.subplots()
    at = np.linspace(0, steps, curves.shape[1])
    for curve in curves:
        axes.plot(at, curve, color="#009E73", alpha=0.35, linewidth=1)
    axes.plot(at, curves.mean(axis=0), color="#009E73", linewidth=2, label="MaskablePPO, mean of the seeds")
    for name, value in shipped.items():
        axes.axhline(value, color=COLOURS[name], linestyle="--", linewidth=1.2, label=name)
    axes.set(xlabel="steps of training", ylabel="discounted return")
    axes.legend(frameon=False, fontsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    canvas.savefig(file, dpi=130)


if __name__ == "__main__":
    main()
