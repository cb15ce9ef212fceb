"""`python -m bench`: every figure, one table after the other."""

from bench import (
    bench_aboard,
    bench_atmc,
    bench_avoidance,
    bench_channel,
    bench_gate,
    bench_heart,
    bench_inspect,
    bench_links,
    bench_lockstep,
    bench_remote_id,
)

for module in (
    bench_avoidance,
    bench_heart,
    bench_gate,
    bench_aboard,
    bench_lockstep,
    bench_remote_id,
    bench_channel,
    bench_atmc,
    bench_inspect,
    bench_links,
):
    print(f"\n== {(module.__doc__ or '').splitlines()[0]}\n", flush=True)
    module.main()
