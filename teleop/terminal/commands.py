"""The command line: commands, their options and their help."""

from __future__ import annotations

from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Callable

from teleop.terminal.options import (
    Parser,
    json_option,
    out_option,
    plot_option,
    realtime_option,
    scene_options,
    seed_number,
    tick_options,
    whole,
)
from teleop.version import __version__

FIRST = """\
Move a robot far away and feel what it touches, although the network delays,
jitters and drops packets: control laws for bilateral teleoperation, live and
in virtual time.

three things to try
  teleop demo --page
      in the browser: drag the master, press the wall, change law and delay
  teleop demo
      the same without a browser: ten seconds live, then a table and a record
  teleop run soft_tissue --set law=direct --set delay=0.05
      in virtual time: reflecting the force as it is diverges; law=wave stays

all commands: teleop --help; all scenes, laws and effects: teleop list
"""

EXAMPLES = """\
examples:
  teleop run hard_wall
  teleop run canonical --set law=pfra --set law.alpha=0.2 --set delay=0.1 --plot
  teleop run hard_wall --link 'delay(0.04) | uniform(0.02) | bernoulli(0.02)' --seed 7 --json
  teleop run hard_wall --set law=law_mine.py --set law.K=150
  teleop run arm --robot mujoco
  teleop demo jittery_wan
  teleop precision hard_wall --set k_e=1e6
  teleop stability soft_tissue --set law=direct --critical k_e
  teleop passivity virtual_coupling --plot
  teleop zwidth virtual_wall --set step=1e-5 --set friction=0.02 --plot
  teleop sweep soft_tissue --grid law=direct,wave delay=0:0.1:21 k_e=10:1e4:21:log --plot
  teleop tune wave --scene hard_wall --set delay=0.1 --budget 200
  teleop advise --link 'delay(0.06) | uniform(0.04) | bernoulli(0.03)' --wall 2000
  teleop matrix
  teleop reproduce gil
  teleop compare --laws wave,pfra --plot
  teleop study check scenarios/examples/people/discrimination.toml
  teleop list hard_wall
  teleop report runs/hard_wall-1 --plot --format pdf
  teleop replay runs/hard_wall-1 --set law.b=4
  teleop export runs/hard_wall-1 --mcap hard_wall.mcap --csv hard_wall.csv
  teleop stream runs/hard_wall-2 --plotjuggler 127.0.0.1:9870
  teleop emit bench_top --end m --set law=pp --out handle
"""


def parser(*names: str) -> ArgumentParser:
    """The parser of the command line; `do` of what it parsed is the command's name, None if none was typed.

    With the `names` of commands it knows these alone, which takes a tenth of the time.
    """
    whole_parser = Parser(
        prog="teleop", epilog=EXAMPLES, formatter_class=RawDescriptionHelpFormatter, allow_abbrev=False,
        description="A delayed bilateral teleoperation stack: run a scene in virtual time or live.",
    )
    whole_parser.add_argument("--version", action="version", version=f"bilateral-teleop {__version__}")
    whole_parser.set_defaults(do=None, json=False)
    commands = whole_parser.add_subparsers(title="commands", metavar="COMMAND")
    for name in names or COMMANDS:
        text, options = COMMANDS[name]
        added: ArgumentParser = commands.add_parser(name, help=text, description=text, allow_abbrev=False)
        added.set_defaults(do=name)
        options(added)
    return whole_parser


def _picture(added: ArgumentParser, whose: str = "") -> None:
    then = f"; draws{whose}, as --plot does"
    added.add_argument("--picture", metavar="KIND", help="stability (how rows ended, over two knobs), metric (one over "
                       f"two knobs) or curves (one over one knob); left out: by what varies and how rows ended{then}")
    added.add_argument("--metric", metavar="NAME", help=f"the metric that it shows; left out: the first{then}")


def _run(added: ArgumentParser) -> None:
    scene_options(added)
    added.add_argument("--bodies", metavar="METHOD:N", help="move the bodies by N sub-steps a tick of a fixed-step "
                       "method, for example semi_implicit_euler:40 (see `teleop list bodies`); left out: exactly")
    added.add_argument("--hand", metavar="FOLDER", help="move the scene's hand as the pointer moved that of a live "
                       "page, whose folder this is (or one of its parts), for as long unless --set duration= says "
                       "otherwise; left out: as the scene says")
    added.add_argument("--device", metavar="NAME", help="what stands at the master's end: a device by name, NAME or "
                       "NAME:ARGUMENT, or FILE.py:CLASS; left out: the simulated master")
    added.add_argument("--robot", metavar="NAME", help="what stands at the slave's end, for example mujoco, or "
                       "mujoco:FILE.xml#TIP@POSE, POSE a keyframe or q=Q1,Q2,...; left out: the simulated slave")
    out_option(added, "SCENE")
    json_option(added)
    plot_option(added, "plot.png")


def _demo(added: ArgumentParser) -> None:
    scene_options(added, default="hard_wall")
    out_option(added, "SCENE")
    json_option(added)
    plot_option(added, "plot.png")
    added.add_argument("--lockstep", action="store_true",
                       help="step both ends together over UDP: bit for bit what `teleop run` gives")
    added.add_argument("--device", metavar="NAME", help="what stands at the master's end, as `python -m master` takes "
                       "it (see `teleop list devices`); left out: the simulated one")
    added.add_argument("--robot", metavar="NAME", help="the same at the slave's end (see `teleop list robots`)")
    added.add_argument("--page", action="store_true", help="show it in a browser, on a page where the hand is moved "
                       "and law, link and wall are turned while it runs, until Ctrl-C (needs the extra `page`)")
    added.add_argument("--port", metavar="N", type=whole, help="of the page; left out: that of the last page if it is "
                       "free, or another one")
    added.add_argument("--keep", metavar="SIZE", help="bound on what the page writes, as 2GB: the oldest parts are "
                       "removed; left out: the whole session is kept")
    added.add_argument("--open", action="store_true", help="open the page in the browser")
    tick_options(added)
    realtime_option(added)


def _sweep(added: ArgumentParser) -> None:
    scene_options(added, seed=False)
    added.add_argument("--grid", metavar="KNOB=VALUES", nargs="+", action="extend", default=[],
                       help="axes of the grid: delay=0:0.5:51, k_e=1e2:1e6:9:log, law=wave,pfra; several are "
                       "crossed, in one --grid or in several")
    added.add_argument("--seeds", metavar="N", type=whole, default=1,
                       help="every point with the seeds 0 .. N-1; left out: 1")
    added.add_argument("--latin", metavar="N", type=whole, help="N points drawn from the ranges of --grid "
                       "(delay=0:0.5, k_e=1e2:1e6:log, law=wave,pfra) in place of all of them: a Latin hypercube")
    added.add_argument("--random", metavar="N", type=whole, help="the same, each point by itself")
    added.add_argument("--metrics", metavar="NAMES", help="which metrics, joined by commas; left out: the tracking "
                       "error, the largest force, the energies")
    added.add_argument("--engine", metavar="NAME", help="plain, or by the C compiler: c (a row at a time) or "
                       "vector (several); left out: by the amount of work")
    added.add_argument("--workers", metavar="N", type=whole, help="rows run in N threads; left out: one for each core")
    added.add_argument("--cluster", metavar="ADDRESS", help="HOST:PORT of a dask scheduler whose workers run the rows "
                       "(needs the extra `cluster`); left out: this machine")
    added.add_argument("--out", metavar="DIR", help="the folder of the sweep, new or to be gone on with; default "
                       "runs/SCENE-sweep")
    added.add_argument("--yes", action="store_true", help="more than 1e9 rows are meant")
    json_option(added)
    plot_option(added, "sweep.png")
    _picture(added)


def _set_and_link(added: ArgumentParser) -> None:
    added.add_argument("--set", metavar="NAME=VALUE", action="append", default=[],
                       help="a knob of the scene, or one of the law (law.K=500), which is then not turned; may be "
                       "repeated")
    added.add_argument("--seed", metavar="N", type=seed_number, default=0, help="keys the points of the search and the "
                       "link's random draws; left out: 0")


def _tune(added: ArgumentParser) -> None:
    added.add_argument("law", metavar="LAW", help="a law's name (see `teleop list laws`), or a FILE.py with one")
    added.add_argument("--scene", metavar="SCENE", required=True, help="a scene's name or the path of a .py file")
    _set_and_link(added)
    added.add_argument("--link", metavar="SPEC", help="another link in place of the scene's, as `teleop run` takes it")
    added.add_argument("--budget", metavar="N", type=whole, default=300, help="most rows that are run; left out: 300")
    added.add_argument("--objective", metavar="NAME", default="balanced", help="what is made least: balanced "
                       "(tracking, drag, and what is missing of the steady force at wall and hand), tracking, force or "
                       "drag; left out: balanced")
    added.add_argument("--margin", metavar="M", type=float, default=1.0, help="the constraints are to be kept too "
                       "where the environment is M times as stiff (knob k_e); left out: 1")
    added.add_argument("--playouts", metavar="LIST", help="playouts that are tried too, joined by commas, for example "
                       "integral,fixed:0.1:integral; left out: the scene's alone")
    added.add_argument("--engine", metavar="NAME", help="plain, c or vector; left out: by the amount of work")
    added.add_argument("--workers", metavar="N", type=whole, help="rows run in N threads; left out: one for each core")
    out_option(added, "LAW-tune")
    json_option(added)
    plot_option(added, "tune.png")


def _advise(added: ArgumentParser) -> None:
    added.add_argument("--ping", metavar="FILE", help="the link as `ping -D -i 0.02 HOST > FILE` has recorded it")
    added.add_argument("--link", metavar="SPEC", help="or the link as `teleop run` takes it; recordings are links too: "
                       "mahimahi('up') ; mahimahi('down'), recorded('runs/hard_wall-1')")
    added.add_argument("--wall", metavar="K_E", type=float, help="stiffness of the wall in N/m; left out: the scene's")
    added.add_argument("--scene", metavar="SCENE", default="hard_wall", help="what is done over the link; left out: "
                       "hard_wall, a reach into a wall that is pressed then")
    _set_and_link(added)
    added.add_argument("--budget", metavar="N", type=whole, help="most rows of the search, shared by the laws; left "
                       "out: 12,000 for each law, 60 where there is no C compiler")
    added.add_argument("--laws", metavar="LIST", help="laws that are tried, joined by commas; left out: all with two "
                       "ends")
    added.add_argument("--objective", metavar="NAME", default="balanced", help="as `teleop tune` has it; left out: "
                       "balanced")
    added.add_argument("--workers", metavar="N", type=whole, help="search the laws in N processes; left out: one for "
                       "each core")
    added.add_argument("--out", metavar="DIR", help="the folder that keeps the points; the same command there goes on "
                       "where it stopped; left out: runs/SCENE-advise")
    json_option(added)
    plot_option(added, "advise.png")


def _matrix(added: ArgumentParser) -> None:
    added.add_argument("file", metavar="FILE", nargs="?",
                       help="a matrix of your own, TOML; left out: the built-in scenarios/matrix.toml")
    added.add_argument("--out", metavar="DIR", help="a folder that keeps the rows, a sweep for each block, and can be "
                       "gone on with; left out: none")
    json_option(added)


def _compare(added: ArgumentParser) -> None:
    added.add_argument("file", metavar="FILE", nargs="?",
                       help="a comparison of your own, TOML, or the name of a scene, over its own link; left out: the "
                       "built-in scenarios/compare.toml")
    added.add_argument("--laws", metavar="NAMES", help="compare these laws, names or FILE.py, joined by commas; left "
                       "out: those of the file, the built-in one has every law with two ends")
    added.add_argument("--tuned", metavar="N", type=whole, nargs="?", const=60, help="each law with the parameters "
                       "that `teleop tune` finds in N rows for each link, left out: 60; a search takes seconds")
    added.add_argument("--workers", metavar="N", type=whole, help="rows run in N processes; left out: one a core")
    added.add_argument("--out", metavar="DIR", help="the folder of the comparison, new or to be gone on with; default "
                       "runs/FILE, without its ending")
    json_option(added)
    plot_option(added, "a figure for each question")


def _study(added: ArgumentParser) -> None:
    from teleop.terminal.study_options import study_options  # which no other command needs

    study_options(added)


def _axis(added: ArgumentParser) -> None:
    added.add_argument("--axis", metavar="NAME", help="of a scene whose axes have parts of their own: the one meant")


def _precision(added: ArgumentParser) -> None:
    scene_options(added)
    _axis(added)
    out_option(added, "SCENE-precision")
    json_option(added)
    plot_option(added, "precision.png")
    added.add_argument("--rounds", metavar="N", type=whole,
                       help="how often each is timed; left out: as often, and as many, as fit into a minute")


def _stability(added: ArgumentParser) -> None:
    scene_options(added)
    added.add_argument("--critical", metavar="KNOB", help="find the value of this knob at which the verdict changes")
    added.add_argument("--range", metavar="LOW:HIGH", help="where to look for it; left out: a hundredth of the knob's "
                       "own value to a hundred times that")
    added.add_argument("--tol", metavar="X", help="how closely, in the knob's unit; left out: 1e-6 of the value (with "
                       "--time: a step of the search halved 5 times)")
    added.add_argument("--continuous", action="store_true", help="the delay margin in continuous time too")
    added.add_argument("--time", action="store_true",
                       help="judge by a run in virtual time: for scenes that are not linear")
    added.add_argument("--out", metavar="DIR", help="the new folder to write summary.json into; left out: none, or "
                       "with --plot runs/SCENE-stability-NUMBER")
    json_option(added)
    plot_option(added, "stability.png, and with --critical critical.png,")


def _passivity(added: ArgumentParser) -> None:
    scene_options(added)
    _axis(added)
    added.add_argument("--range", metavar="LOW:HIGH", help="frequencies in Hz; left out: 0.1 to half the rate, of two "
                       "ports 0.49 of it")
    added.add_argument("--out", metavar="DIR", help="the new folder to write summary.json and curves.npz into; "
                       "left out: none, or with --plot runs/SCENE-passivity-NUMBER")
    json_option(added)
    plot_option(added, "passivity.png")


def _zwidth(added: ArgumentParser) -> None:
    scene_options(added)
    _axis(added)
    added.add_argument("--range-k", metavar="LOW:HIGH", help="stiffness (N/m) in which to look for what is stable and "
                       "what comes to rest; left out: all")
    added.add_argument("--range-b", metavar="LOW:HIGH", help="the same of damping (N s/m)")
    out_option(added, "SCENE-zwidth")
    json_option(added)
    plot_option(added, "plane.png, impedance.png and levers.png")


def _reproduce(added: ArgumentParser) -> None:
    added.add_argument("name", metavar="NAME", nargs="?", help="one publication, for example diolaiti; left out: all")
    added.add_argument("--out", metavar="DIR", help="the new folder to write summary.json and page.md into; left out: "
                       "none")
    json_option(added)


def _list(added: ArgumentParser) -> None:
    added.add_argument("name", metavar="NAME", nargs="?", help="a scene, a law, an effect, a velocity estimator or "
                       "the FILE.py of one of your own: shows its knobs; or all that there is of a kind: scenes, laws, "
                       "effects, estimators, metrics, playout, stages, bodies, devices, robots; left out: the first "
                       "four of these")
    json_option(added)


def _check(added: ArgumentParser) -> None:
    added.add_argument("what", metavar="device|robot", choices=("device", "robot"),
                       help="what stands at the master's end, or at the slave's")
    added.add_argument("name", metavar="NAME", help="its name (see `teleop list devices`), NAME:ARGUMENT, or "
                       "FILE.py:CLASS of your own")
    scene_options(added, default="hard_wall", seed=False)
    added.add_argument("--push", action="store_true", help="push a machine too, along each axis in turn, to see which "
                       "way its force acts: see that nobody and nothing is in its way; left out: only what is "
                       "simulated is pushed")
    added.add_argument("--force", metavar="F", type=float, help="of the push, in N or N m; left out: 0.1 on a machine, "
                       "at most 1 in simulation")
    added.add_argument("--ticks", metavar="N", type=whole, default=1000, help="read so often, a machine by the clock; "
                       "left out: 1000; with more you have the time to unplug it and to plug it in again")
    json_option(added)


def _identify(added: ArgumentParser) -> None:
    added.add_argument("what", metavar="device|robot", choices=("device", "robot"),
                       help="what stands at the master's end, or at the slave's")
    added.add_argument("name", metavar="NAME", help="its name and address, as feetech:/dev/ttyACM0?ids=1-6")
    scene_options(added, default="servo_arm", seed=False)
    added.add_argument("--reach", metavar="RAD", type=float, required=True, help="how far each joint may move from "
                       "where it is, either way, at most 0.5")
    added.add_argument("--inertia", metavar="J", required=True, help="moment of inertia that each joint moves, kg m^2, "
                       "one number or one for each: fasten something known to it")
    added.add_argument("--out", metavar="FILE", required=True, help="the file to write")
    json_option(added)


def _show(added: ArgumentParser) -> None:
    added.add_argument("what", metavar="tick", choices=("tick",), help="what the scene's loop does, line by line")
    scene_options(added, seed=False)
    added.add_argument("--end", choices=("m", "s"), help="the live end of the master or of the slave, by itself")
    json_option(added)


def _manifest(added: ArgumentParser) -> None:
    scene_options(added, seed=False)
    added.add_argument("--write", metavar="FILE", help="write the manifest as msgpack, as HELLO and WELCOME carry it")
    json_option(added)


def _emit(added: ArgumentParser) -> None:
    scene_options(added, seed=False)
    added.add_argument("--end", choices=("m", "s", "hand"), required=True, help="the end that is printed: the master, "
                       "the slave, or hand, the only one of a scene without a slave")
    added.add_argument("--float", action="store_true", help="single precision, for a processor whose unit has no "
                       "doubles: not the bits of Python; refused where a float does not suffice")
    out_option(added, "SCENE-emit")
    json_option(added)


def _report(added: ArgumentParser) -> None:
    added.add_argument("folders", metavar="FOLDER", nargs="+",
                       help="the folder that a run, a page, a sweep, a comparison or a study wrote; several are shown "
                       "side by side; those of a master and of its slave that ran by hand are put together, as a new "
                       "run")
    added.add_argument("--html", metavar="FILE", help="the file of the page; left out: report.html in the folder, of "
                       "several in this one; a file of that name that differs stays, and the page is report-2.html")
    added.add_argument("--open", action="store_true", help="open the page in the browser")
    added.add_argument("--out", metavar="DIR", help="with MASTER SLAVE: the new folder of the run; default "
                       "runs/SCENE-NUMBER")
    added.add_argument("--trust", action="store_true", help="run the scene's own file, and read the files, that the "
                       "folder names: for folders of your own, or that you have read")
    plot_option(added, "plot.png or sweep.png")
    _picture(added, " a sweep")
    added.add_argument("--rows", metavar="N", type=whole, help="of a sweep: show its first N rows; left out: a few")
    json_option(added, "print the stored summary and nothing else, and write a page only with --html or --open")


def _replay(added: ArgumentParser) -> None:
    added.add_argument("run", metavar="FOLDER", help="the folder of a live end, or that of a demo, which has both")
    added.add_argument("slave", metavar="SLAVE", nargs="?", help="the slave's folder, where FOLDER is its master's")
    added.add_argument("--set", metavar="NAME=VALUE", action="append", default=[],
                       help="another law or knob than the run had: says what it would have commanded, open loop; may "
                       "be repeated")
    added.set_defaults(link=None)
    added.add_argument("--trust", action="store_true", help="run the scene's own file, and read the files, that the "
                       "folder names: for folders of your own, or that you have read")
    added.add_argument("--out", metavar="DIR", help="the new folder to write summary.json and forces.npz into; left "
                       "out: none, or with --plot runs/SCENE-replay-NUMBER")
    json_option(added)
    plot_option(added, "replay.png")


def _export(added: ArgumentParser) -> None:
    added.add_argument("run", metavar="FOLDER", help="the folder of a run that is over: of teleop run, of a demo, of a "
                       "live end, or one with parts")
    added.add_argument("--mcap", metavar="FILE", help="a new file for Foxglove and all that reads MCAP: JSON messages "
                       "with their schemas (needs the extra `log`)")
    added.add_argument("--csv", metavar="FILE", help="a new file for pandas and all that reads CSV; beside it "
                       "FILE-metadata.json with the units")
    added.add_argument("--trust", action="store_true", help="where a killed process left the folder: run the scene's "
                       "own file, and read the files, that it names")
    json_option(added)


def _stream(added: ArgumentParser) -> None:
    added.add_argument("run", metavar="FOLDER", help="the folder that a live end or a demo is writing, or has written")
    added.add_argument("--plotjuggler", metavar="HOST:PORT", required=True, help="where PlotJuggler's UDP Server "
                       "listens, for example 127.0.0.1:9870; rows go there as JSON, neither encrypted nor answered")
    added.add_argument("--rows", metavar="N", type=whole, default=16, help="rows a datagram, at most; left out: 16; 1 "
                       "for PlotJuggler before 3.16.0")
    json_option(added)


def _doctor(added: ArgumentParser) -> None:
    added.add_argument("--clear", action="store_true", help="remove the compiled kernels")
    json_option(added)


def _keygen(added: ArgumentParser) -> None:
    added.add_argument("name", metavar="NAME", help="the file to write, NAME.key")
    json_option(added)


def _completion(added: ArgumentParser) -> None:
    added.add_argument("shell", metavar="SHELL", choices=("bash", "zsh", "fish"), help="bash, zsh or fish; the head of "
                       "its script says where it belongs")


COMMANDS: dict[str, tuple[str, Callable[[ArgumentParser], None]]] = {
    "run": ("Run a scene in virtual time: the same seed gives the same bits.", _run),
    "demo": ("Run a scene live, slave, channel and master as three processes.", _demo),
    "sweep": ("Run a scene over a grid of knobs and seeds; the same command goes on where it stopped.", _sweep),
    "tune": ("Search the parameters of a law for a scene: a Latin hypercube, then an evolution strategy, in a stated "
             "number of rows.", _tune),
    "advise": ("Advise a law and its gains for a link and a wall: every law with two ends is tuned, and what speaks "
               "against the others is said; the same command goes on where it stopped.", _advise),
    "matrix": ("Run the delay-scenario test matrix: laws, scenes, delays and losses, each row against the status "
               "expected of it.", _matrix),
    "compare": ("Compare laws over links, environments and seeds: one table, and with --plot a figure a question; the "
                "same command goes on where it stopped.", _compare),
    "study": ("Experiments with people: check a plan, simulate it, analyse and unblind a study, run a trial again.",
              _study),
    "precision": ("Measure error against run time: the exact steps beside every other way to integrate.", _precision),
    "stability": ("Count the unstable roots of a linear scene's exact sampled loop, and find its margins.", _stability),
    "passivity": ("Two-port: hybrid matrix, Llewellyn's criterion, transparency; one port: is its sampled controller "
                  "passive.", _passivity),
    "zwidth": ("Z-width of a one-port scene: stable and passive stiffness and damping, impedance over frequency, and "
               "what widens it. Ctrl-C keeps what is done.", _zwidth),
    "reproduce": ("Run published comparisons again, each number beside the printed one.", _reproduce),
    "list": ("List scenes, laws, effects, velocity estimators, metrics, playouts, stages, bodies (their "
             "integrators), devices and robots, or the knobs of one.", _list),
    "show": ("Show the tick of a scene as plain Python: the lines that are run, and no others.", _show),
    "manifest": ("Print what an end in another language has to say in a scene's packets: manifest, fields in their "
                 "places, sizes, examples in hex; see teleop/protocol/WIRE.md.", _manifest),
    "emit": ("Print an end as C99 for a microcontroller or another language, with the bits of Python: header, code, a "
             "check against 500 ticks of Python, and how to call it.", _emit),
    "check": ("Check a device or a robot: its readings, their times, the sign of its force, and how it lets go.",
              _check),
    "identify": ("Measure stiffness, damping, friction and lateness of the position servos of an arm, by small motions "
                 "of each joint in turn: see that nobody and nothing is in its way.", _identify),
    "doctor": ("Show what is installed and kept, and measure what this machine gives a live end, in about three "
               "seconds, each with what to type where it is poor.", _doctor),
    "keygen": ("Make a key and its certificate, and print the fingerprint that the other end has to be told.", _keygen),
    "completion": ("Print the script with which a shell completes what is typed: commands, options, scenes, laws, "
                   "knobs.", _completion),
    "report": ("Show stored folders again, and write them as one page of HTML, whose figures need the extra `plot`; "
               "--plot draws files too.", _report),
    "replay": ("Run the law of each end of a live run again over what the end read and heard: the same to the bit, or "
               "where not; with --set, what another law would have commanded.", _replay),
    "export": ("Write a run that is over as a file for other tools: MCAP for Foxglove, CSV for pandas.", _export),
    "stream": ("Send a live run to PlotJuggler as it grows, from a process of its own.", _stream),
}
