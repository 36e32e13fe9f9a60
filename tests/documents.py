"""Results as `legibility` writes them, with made-up numbers."""

from legibility.evaluation.comparison import EXTERNAL, TESTED
from legibility.evaluation.comparison import METRICS as MOTION_METRICS
from legibility.evaluation.configuration import MODES
from legibility.evaluation.contest import METHODS, OURS
from legibility.evaluation.controller import ROWS as DISTURBED
from legibility.evaluation.dial import LIMITS, METRICS
from legibility.evaluation.execution import ROWS
from legibility.evaluation.external import METHODS as EXTERNAL_PLANNERS
from legibility.evaluation.external import METRICS as EXTERNAL_METRICS
from legibility.evaluation.eyes import EYES
from legibility.evaluation.single_scene import ROWS as ROWS_OF_ONE_SCENE
from legibility.evaluation.timing import METRICS as TIMED

MODEL = {"name": "m", "path": "a" * 64, "policy": "b" * 64}
OF_MOTIONS = {"success", "deviation"}


def summary(mean):
    return {"mean": mean, "interval": [mean - 0.01, mean + 0.01], "median": mean + 0.001,
            "min": mean - 0.1, "max": mean}  # fmt: skip


def dial(closed_loop=False, regime="dragan"):
    def metrics(mode):
        step = 0.1 * MODES.index(mode)
        return {
            name: summary(0.5 + step + i / 100)
            for i, name in enumerate(METRICS)
            if (closed_loop or name not in OF_MOTIONS)
            and (name != "error_candidates" or (mode == "quick" and not closed_loop))
        }

    modes = ("quick",) if closed_loop else MODES
    limits = {name: summary(0.25 + i / 100) for i, name in enumerate(LIMITS)}
    overall = {"scenes": 3, "limits": limits, **{mode: metrics(mode) for mode in modes}}
    return {
        "command": f"legibility evaluate dial --regime {regime} --scenes 3", "seed": 7,
        "model": MODEL,
        "config": {"scenes": 3, "regime": regime, "goals": [2, 6], "levels": 21, "samples": 8,
                   "candidates": 16, "closed_loop": closed_loop},
        "result": {**({"env": "BlockReach2D"} if closed_loop else {}),
                   "overall": overall, "sound": overall, "degenerate": None,
                   "levels": [-1, 0, 1], "scenes": [{}, {}, {}]},
    }  # fmt: skip


def eyes():
    rows = {
        name: {
            "seen_by": {
                other: {"score": summary(0.5 + (i == j) / 2), "posterior": summary(0.25)}
                for j, other in enumerate(EYES)
            },
            "dragan_rises": summary(0.875),
        }
        for i, name in enumerate(EYES)
    }
    return {
        "command": "legibility evaluate eyes --seed 7", "seed": 7, "model": MODEL,
        "config": {"scenes": 3, "regime": "dragan", "goals": [2, 6], "levels": 11, "samples": 4,
                   "exact": False},
        "result": {"rows": rows, "scenes": [{}, {}, {}]},
    }  # fmt: skip


def planning():
    rows = {
        name: {
            "error": summary(0.01 * (i + 1)), "feasible": summary(1.0),
            "new": summary(10.0 * i + 5), "known": summary(2.0 * i + 1),
        }
        for i, name in enumerate(("bare", "quick", "exact", "archive", "search 64", "search 256"))
    }  # fmt: skip
    place = {"planners": rows, "noise": summary(0.008)}
    return {
        "command": "legibility evaluate planning --seed 7", "seed": 7, "model": MODEL,
        "config": {"scenes": 3, "goals": [2, 6], "levels": 11, "search": [64, 256]},
        "result": {"dragan": place, "obstacles": place},
    }  # fmt: skip


def optimum():
    row = {
        "of_optimum": summary(0.96), "of_bound": summary(0.9), "archive_of_optimum": summary(0.95),
        "archive_of_bound": summary(0.89), "length": summary(1.75),
    }  # fmt: skip
    ends = {"1": row, "-1": None}
    scenes = [{"dragan": {"1": {}, "-1": None}}, {"dragan": {"1": None, "-1": None}}]
    return {
        "command": "legibility evaluate optimum --seed 7", "seed": 7, "model": MODEL,
        "config": {"scenes": 2, "regime": "dragan", "goals": [2, 6], "starts": 8, "exact": False},
        "result": {"rows": {"dragan": ends}, "scenes": scenes},
    }  # fmt: skip


def external():
    best = [{"share": 0.5, "legibility": summary(0.75)}, {"share": 0.0, "legibility": None},
            {"share": 1.0, "legibility": summary(0.875)}]  # fmt: skip
    method = {m: summary(0.125) for m in EXTERNAL_METRICS}
    method |= {"ceiling": best + best[:2], "clear": best + best[:1]}
    return {
        "command": "legibility evaluate external --seed 7", "seed": 7, "model": MODEL,
        "config": {"scenes": 50, "regime": "obstacles", "goals": [2, 6], "levels": 11},
        "result": {"methods": dict.fromkeys(EXTERNAL_PLANNERS, method)},
    }  # fmt: skip


def controller():
    spread = {"median": 0.5, "percentile": 5.25, "greatest": 7.125}
    row = {
        "motions": 50,
        "success": {"mean": 0.98, "interval": (0.9, 1.0)},
        "error": summary(0.03125),
        "turned": summary(1.5),
        "contacts": 0,
        "step": spread,
    }
    rows = {
        name: {
            **row,
            "turn": spread if row_.event else None,
            "delay": spread if row_.event else None,
        }
        for name, row_ in DISTURBED.items()
    }
    return {
        "command": "legibility evaluate controller --seed 7", "seed": 7, "model": MODEL,
        "config": {"scenes": 50, "regime": "dragan", "goals": [2, 4], "dt": None,
                   "budget": 0.003, "backend": "onnx"},
        "result": {"rows": rows, "dt": 0.04},
    }  # fmt: skip


def timing():
    row = {"median": 0.5, "percentile": 0.875, "greatest": 0.9375}
    return {
        "command": "legibility evaluate timing --seed 7", "seed": 7, "model": MODEL,
        "config": {"scenes": 50, "regime": "dragan", "goals": [2, 4], "levels": 5,
                   "limits": "fr3", "arm": None},
        "result": {"metrics": dict.fromkeys(TIMED, row), "error": summary(0.0625),
                   "planned": summary(0.0625), "motions": 249, "refused": 1,
                   "why": ["its hand touches table after 0.50 s"], "moves": "panda"},
    }  # fmt: skip


def execution():
    rows = {}
    for number, name in enumerate(ROWS):
        rows[name] = {
            "success": {"mean": 1 - number / 1000, "interval": (0.9, 1.0)},
            "reasons": {"reached": 5000 - number, "stalled": number} if number else
            {"reached": 5000},
            "within_5_cm": 0.995, "spearman_of_plan": summary(0.97), "error_of_plan": summary(0.01),
            "counts": {}, "farthest_outside": -0.001,
            "spearman": summary(0.9), "error": summary(0.02), "deviation": summary(0.0012),
            "jerk": summary(12.5), "turned": summary(2.25), "turned_of_plan": summary(2.0),
            "replanned": 0.25, "states_outside": 1, "actions_not_finite": 0,
            "actions_over_limit": 2, "wall_contacts": 3, "contacts": 1234 * number,
        }  # fmt: skip
    for key in ("spearman", "error", "within_5_cm"):
        del rows["policy, goal moved"][key]
    return {
        "command": "legibility evaluate execution --seed 7", "seed": 7, "model": MODEL,
        "config": {"rollouts": 5000, "scenes": 200, "regime": "dragan", "goals": [2, 6],
                   "disturbance": None},
        "result": {"rows": rows, "env": "BlockReach2D", "disturbance": 0.1},
    }  # fmt: skip


def transfer():
    document = execution()
    document["result"]["env"] = "PandaGymBlockReach"
    for number, row in enumerate(document["result"]["rows"].values()):
        row |= {"counts": {"table_contacts": number, "self_collisions": 2},
                "farthest_outside": 0.0012}  # fmt: skip
    return document


def ablations():
    names = ("spearman", "error", "at_1", "at_-1", "length_ratio_at_0", "feasible", "waves")
    overall = {name: summary(0.5 + i / 100) for i, name in enumerate(names)}
    rows = {name: {"text": f"row {name}", "small_run": name == "b", "sha256": "a" * 64,
                   "overall": overall, "quick_error": summary(0.25),
                   "plan_ms": 7.25} for name in "ab"}  # fmt: skip
    return {
        "command": "legibility evaluate ablations --seed 7", "seed": 7, "model": MODEL,
        "config": {"scenes": 50, "goals": [2, 6], "levels": 11, "samples": 4,
                   "training_steps": 3000, "batch_scenes": 64, "training_scenes": 3200},
        "result": {"rows": rows, "data": "d" * 64},
    }  # fmt: skip


def tests(cells):
    pairs = [(ours, name) for ours in OURS for name in METHODS if name not in OURS]
    pairs += [("search", "diffusion policy"), ("straight line", "diffusion policy")]
    return [
        {"cell": cell, "method": a, "against": b, "effect": -0.5 if a == "search" else 0.5,
         "p_holm": 0.5 if a == "straight line" else 0.0001}
        for cell in cells for a, b in pairs
    ]  # fmt: skip


BASELINES = [{"name": "diffusion-policy-x", "goal": "e" * 64},
             {"name": "legibility-diffuser-x", "goal": "f" * 64}]  # fmt: skip


def table1():
    target = {"success": {"mean": 0.9996}, **{m: summary(1.5) for m in MOTION_METRICS | EXTERNAL}}
    methods = {
        name: {"milliseconds": None if name == "oracle" else {"plan": 1.25, "motion": 30},
               "targets": {"R": target, "G": target}}
        for name in METHODS
    }  # fmt: skip
    return {
        "command": "legibility evaluate table1 --seed 7", "seed": 7, "model": MODEL,
        "baselines": BASELINES, "config": {"rollouts": 100},
        "result": {
            "env": "BlockReach2D", "scene": {"start": [0, 0.5]}, "methods": methods,
            "oracle": {letter: dict.fromkeys(MOTION_METRICS, 3.0) for letter in "RG"},
            "tests": tests([f"{letter} {metric}" for letter in "RG" for metric in TESTED]),
            "search": [64, 640],
        },
    }  # fmt: skip


def single_scene():
    document = table1()
    result = document["result"]
    result["methods"]["legibility diffuser, L_p"] = result["methods"]["legibility diffuser"]
    result["tests"] += [{**t, "against": "legibility diffuser, L_p"} for t in result["tests"]
                        if t["against"] == "legibility diffuser"]  # fmt: skip
    tuned = {"chosen": {"guidance": 25.0, "guidance_decay": 0.8}, "tried": [{}] * 7}
    result["methods"] = {name: result["methods"][name] for name in ROWS_OF_ONE_SCENE}
    result["demonstrated"] = result.pop("oracle")
    result["tuning"] = {key: {"legibility diffuser": tuned} for key in "RG"}
    del result["search"], document["baselines"], document["model"]
    document["command"] = "legibility evaluate single-scene --seed 7"
    document["config"] = {"rollouts": 100, "demonstrations": 150, "training_steps": 3000,
                          "batch": 256, "tuning_rollouts": 32, "networks": 3}  # fmt: skip
    return document


def unseen():
    ratio = {"median": 0.25, "interval": [0.125, 0.5]}
    methods = {
        name: {"success": {"mean": 0.75}, "ratio": dict.fromkeys(TESTED, ratio),
               "length_ratio": summary(1.5), "achieved": summary(0.5),
               **{m: summary(0.125) for m in EXTERNAL},
               **({"spearman": summary(0.875), "error": summary(0.0625)} if method.dial else {})}
        for name, method in METHODS.items()
    }  # fmt: skip
    return {
        "command": "legibility evaluate unseen --seed 7", "seed": 7, "model": MODEL,
        "baselines": BASELINES,
        "config": {"scenes": 10, "goals": [2, 6], "rollouts": 4, "levels": 11},
        "result": {
            "env": "BlockReach2D", "methods": methods, "tests": tests(TESTED), "search": [64, 640],
            "least": {"potential_cost": 1e-9},
        },
    }  # fmt: skip


def spectrum(rising=0):
    costs = [3.0, 2.0 + 1.5 * rising, 1.0]
    target = {"mean": costs, "achieved": [-1, 0, 1], "rising": rising, "success": 1.0}
    return {
        "command": "legibility evaluate spectrum --seed 7", "seed": 7, "model": MODEL,
        "config": {"rollouts": 4, "levels": 3},
        "result": {"env": "BlockReach2D", "levels": [-1, 0, 1],
                   "targets": {"R": target, "G": target}},
    }  # fmt: skip


def _row(metric, median, **conditions):
    return {
        "metric": metric, **conditions,
        "median": median, "low": median / 2, "high": 2 * median, "calls": 9,
    }  # fmt: skip


def bench(model="m"):
    torch, onnx = ({"model": model, "backend": backend} for backend in ("torch", "onnx"))
    return {
        "command": "legibility bench", "seed": None, "model": MODEL,
        "config": {
            "rounds": 3, "seconds": 0.2, "batches": [1, 1024], "goals": [2, 4],
            "robots": 256, "arms": 16,
        },
        "result": {
            "machine": {"cpu": "Z80", "cores": 1, "threads": 1, "device": "cpu", "torch": "2.13",
                        "load": 0.5},
            "skipped": ["onnxruntime is not installed"],
            "measurements": [
                _row("plan_ms", 2, **torch, batch=1, goals=4),
                _row("plan_ms", 4000, **torch, batch=1024, goals=4),
                _row("plan_ms", 3, **torch, batch=1, goals=2),
                _row("plan_ms", 1, **onnx, batch=1, goals=4),
                _row("plan_one_core_ms", 0.5, **onnx),
                _row("plan_obstacles_ms", 0.75, **onnx, mode="exact", scene="known"),
                _row("archive_ms", 64.04, dim=2),
                _row("training_steps_per_second", 16, dim=2, precision="bf16"),
                _row("import_ms", 100),
            ],
        },
    }  # fmt: skip
