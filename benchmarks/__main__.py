"""Speed figures and their ratios, all from one run on one machine.

    python -m benchmarks [SECTION ...] [--quick] [--out DIR] [--limit C_FILE] [--vicon FOLDER]

Sections: walk, lanes, detectors, gradient, alignment, sweep (default: all of these); trials, with PyShoe's
Vicon trials; and gpu where there is one. What runs on one core is in processor time, best of three after
compilation; sweeps, trials and a GPU in wall time.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import pedjax
from pedjax.runtime import available_cores

SECTIONS = ("walk", "lanes", "detectors", "gradient", "alignment", "sweep")
APART = ("trials", "gpu")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("sections", nargs="*", choices=[*SECTIONS, *APART, []], metavar="SECTION")
    parser.add_argument("--quick", action="store_true", help="a tenth of the samples")
    parser.add_argument("--out", type=Path, help="folder for the figures as JSON and the picture")
    parser.add_argument(
        "--limit", type=Path, help="C or CUDA source of a hand-written kernel to compare with"
    )
    parser.add_argument("--vicon", type=Path, help="folder of PyShoe's Vicon trials")
    args = parser.parse_args()
    runtime = pedjax.configure(devices=available_cores())
    import jax

    size = 10 if args.quick else 1
    device, fast = jax.devices()[0].device_kind, "on" if runtime.fast else "off"
    print(f"jax {jax.__version__}, {device} x {len(jax.devices())}, fast options {fast}")
    found: dict[str, Any] = {"jax": jax.__version__, "device": device, "fast": runtime.fast}
    for name in args.sections or SECTIONS:
        print(f"\n== {name}", flush=True)
        found[name] = globals()[f"_{name}"](size, args)
    if args.out:
        args.out.mkdir(parents=True, exist_ok=True)
        (args.out / "benchmarks.json").write_text(json.dumps(found, indent=2) + "\n")
        if "lanes" in found:
            from benchmarks.pictures import lanes_figure

            lanes_figure(found["lanes"]).savefig(args.out / "lanes.png", dpi=130)
        if "gpu" in found:
            from benchmarks.pictures import gpu_figure

            gpu_figure(found["gpu"]).savefig(args.out / "gpu.png", dpi=130)


def _walk(size: int, args: argparse.Namespace) -> dict[str, float]:
    import jax.numpy as jnp

    from benchmarks import filters, others
    from pedjax.runtime import double_precision

    found = {"numpy": others.numpy_loop(10_000 // size)}
    print(f"plain numpy loop, 15 states        {found['numpy'] / 1e3:9.1f} k samples/s")
    peer = others.gaitmap_forward(120_000 // size)
    if peer is not None:
        found["gaitmap"] = peer
        print(f"gaitmap, 9 states, with smoother   {peer / 1e3:9.1f} k samples/s")
    with double_precision():
        for dtype in (jnp.float32, jnp.float64):
            name = jnp.dtype(dtype).name
            rate = found[name] = filters.single_walk(120_000 // size, dtype)
            times = f"{rate / found['numpy']:.0f} x numpy"
            times += f", {rate / peer:.1f} x gaitmap" if peer else ""
            print(f"one walk, {name}, 15 states     {rate / 1e3:9.1f} k samples/s   {times}")
    return found


def _trials(size: int, args: argparse.Namespace) -> dict[str, Any]:
    from benchmarks import trials

    if args.vicon is None:
        raise SystemExit("trials: say where PyShoe's Vicon trials are with --vicon FOLDER")
    return trials.measure(args.vicon, size > 1)


def _gpu(size: int, args: argparse.Namespace) -> dict[str, str]:
    from benchmarks import gpu

    return dict(gpu.measure(size > 1, args.vicon, args.limit, workers=available_cores()))


def _lanes(size: int, args: argparse.Namespace) -> dict[str, Any]:
    import jax.numpy as jnp

    from benchmarks import filters, others
    from pedjax.runtime import double_precision, lane_count

    found: dict[str, Any] = {}
    if args.limit:
        found["limit"] = others.c_kernel(args.limit)
        for width, rate in found["limit"].items():
            print(f"hand-written kernel, {width:4} lanes, float32    {rate / 1e6:7.2f} M steps/s on one core")
    best = max(found["limit"].values()) if "limit" in found else None
    with double_precision():
        for dtype in (jnp.float32, jnp.float64):
            name, chosen = jnp.dtype(dtype).name, lane_count(dtype)
            found[name], found[f"{name}_chosen"] = {}, chosen
            for width in [2**k for k in range(13)]:
                length = max(min(1_000_000 // width, 12_000), 1_000) // (1 if size == 1 else 4)
                rate = found[name][width] = filters.lanes(length, width, dtype)
                of = f"   {rate / best:5.1%} of the hand-written" if best and name == "float32" else ""
                mark = "  <- chosen" if width == chosen else ""
                print(
                    f"{name}, {width:4} lanes   {rate / 1e6:7.2f} M steps/s on one core{of}{mark}", flush=True
                )
            double = filters.lanes(12_000 // size, chosen, dtype, **{"updates.zaru": True})
            plain = found[name][chosen]
            print(f"{name}, with a second update of three rows: {plain / double:.2f} times the cost")
            found[f"{name}_second_update"] = plain / double
    return found


def _alignment(size: int, args: argparse.Namespace) -> dict[str, dict[str, float]]:
    from benchmarks import alignment

    found = {method: alignment.shares(60_000 // size, method) for method in ("agda", "weighted")}
    for method, each in found.items():
        told = ", ".join(f"{kind} {share:.2%}" for kind, share in each.items())
        print(f"{method:10} 7 s of ten minutes, of the whole: {told}")
    return found


def _detectors(size: int, args: argparse.Namespace) -> dict[str, float]:
    from benchmarks import filters

    found = filters.statistics(120_000 // size)
    for name, rate in found.items():
        print(f"{name:6} statistic   {rate / 1e6:8.2f} M samples/s")
    return found


def _gradient(size: int, args: argparse.Namespace) -> dict[str, Any]:
    from benchmarks import filters

    found = {}
    length = 120_000 // size  # ten minutes at 200 Hz
    for label, starts, mode, names in (
        ("reverse, 12 parameters, 1 start", 1, "reverse", filters.TUNED),
        ("reverse, 12 parameters, 64 starts", 64, "reverse", filters.TUNED),
        ("forward, 2 parameters, 1 start", 1, "forward", filters.TUNED[:2]),
    ):
        each = found[label] = filters.gradient(length if starts == 1 else length // 4, starts, mode, names)
        print(
            f"{label:34} {each['gradient_us']:6.2f} us a step and start, {each['ratio']:5.2f} forward runs "
            f"(one of {each['forward_us']:.2f} us), {each['temporaries_MiB']:.2f} MiB of temporaries a start",
            flush=True,
        )
    return found


def _sweep(size: int, args: argparse.Namespace) -> dict[str, Any]:
    from benchmarks import sweeps

    found: dict[str, Any] = {"cores": sweeps.cores(60 / size)}
    for name, rate in found["cores"].items():
        if name != "devices":
            print(f"{name.replace('_', ', ')} devices   {rate / 1e6:7.2f} M steps/s (wall, scores included)")
    grown = found["growth"] = sweeps.growth(1_000 // size, 100_000 // size)
    peaks = f"peak memory {grown['peak_before_GiB']:.2f} and {grown['peak_after_GiB']:.2f} GiB"
    print(f"one-minute walk at 100 Hz, {1_000 // size} runs: {grown['few_s']:.2f} s")
    print(
        f"{100_000 // size} runs: {grown['many_s']:.1f} s, {grown['ratio_to_linear']:.2f} of linear, "
        f"{grown['steps_per_s'] / 1e6:.1f} M steps/s, {peaks}"
    )
    if args.vicon:
        each = found["vicon"] = sweeps.vicon(args.vicon)
        print(
            f"18 thresholds x {each['trials']} Vicon trials, files to errors: first call "
            f"{each['first_s']:.1f} s, second {each['second_s']:.1f} s (PyShoe: 700 s for 42 trials)"
        )
    return found


if __name__ == "__main__":
    main()
