"""Laws compared, in cells: an editor that knows `# %%` runs them one by one, Python all of them."""

# %% What is compared
from pathlib import Path

from teleop import load_scene, run, sweep

LAWS = ["wave", "pfra", "direct"]
DELAYS = [0.0, 0.02, 0.05, 0.1]  # s, each way

# %% All of it, as a table
table = sweep("soft_tissue", {"law": LAWS, "delay": DELAYS}, metrics=["x_err_rms", "f_m_max"], fixed={"x_limit": 0.3})
print(table.counts())
for law in LAWS:
    rows = table.where(law=law)
    errors = (f"{1e3 * error:.1f} mm" if status == "ok" else status
            for error, status in zip(rows["x_err_rms"], rows["status"], strict=True))
    print(f"{law:<7}", *(f"{one:>10}" for one in errors))

# %% One run, looked at closely
result = run(load_scene("soft_tissue", law="wave", delay=0.05), seed=1)
print(result.status, result.sentence)
print({name: round(value, 4) for name, value in result.metrics.items() if name.startswith("E_")})

# %% A picture, where matplotlib is installed (the extra `plot`)
try:
    from matplotlib.figure import Figure
except ImportError:
    print("no picture: pip install 'bilateral-teleop[plot]'")
else:
    figure = Figure(figsize=(7, 3), layout="constrained")
    axes = figure.subplots()
    for name in ("x_m", "x_s"):
        axes.plot(result.trace["t"], result.trace[name], label=name)
    axes.set(xlabel="t (s)", ylabel="position (m)")
    axes.legend()
    figure.savefig(Path("compare.png"), dpi=150)
    print("compare.png")
