"""Options of `teleop study` and of its actions."""

from __future__ import annotations

from argparse import ArgumentParser

from teleop.terminal.options import json_option, out_option, plot_option, realtime_option, whole


def study_options(added: ArgumentParser) -> None:
    """Add the actions of `teleop study`, each with its options."""
    actions = added.add_subparsers(title="actions", metavar="ACTION", dest="action", required=True)

    def action(name: str, text: str) -> ArgumentParser:
        parser: ArgumentParser = actions.add_parser(name, help=text, description=text, allow_abbrev=False)
        json_option(parser)
        return parser

    def plan(name: str, text: str) -> ArgumentParser:
        parser = action(name, text)
        parser.add_argument("plan", metavar="PLAN", help="the plan, a file of TOML: see scenarios/examples/people")
        return parser

    def folder(name: str, text: str) -> ArgumentParser:
        parser = action(name, text)
        parser.add_argument("folder", metavar="STUDY", help="the folder of a study")
        return parser

    check = plan("check", "Check a plan: what is felt of each level under each law, balance, power, time and disk.")
    check.add_argument("--lock", action="store_true", help="register the plan: write PLAN.lock with its digest, the "
                       "versions and the date; from then on a changed plan is refused")
    simulate = plan("simulate", "Carry out a study with simulated people: the same journal and the same table.")
    simulate.add_argument("--participants", metavar="N", type=whole, help="so many people; left out: the plan's least")
    simulate.add_argument("--recover", metavar="N", type=whole, help="N studies in memory, and what the analysis makes "
                          "of them: bias, coverage, false alarms, power; writes nothing")
    simulate.add_argument("--out", metavar="DIR", help="the folder of the study, new or to be gone on with; default "
                          "runs/NAME-NUMBER")
    run = plan("run", "Carry out a person's session in a browser: consent, trials, answers, questionnaires.")
    run.add_argument("--participant", metavar="N", type=whole, required=True, help="the number of the person")
    run.add_argument("--device", metavar="NAME", help="a haptic device in the person's hand, by its name (teleop "
                     "list); left out: a mouse, a finger or keys, which render no force")
    run.add_argument("--resume", action="store_true", help="go on with a session that was cut")
    run.add_argument("--out", metavar="DIR", help="the folder of the study, new or to be gone on with; default "
                     "runs/study-NAME")
    run.add_argument("--port", metavar="N", type=whole, help="of the screen; left out: that of the last one if it is "
                     "free")
    run.add_argument("--open", action="store_true", help="open the screen in the browser")
    run.add_argument("--lsl", action="store_true", help="send markers by Lab Streaming Layer (extra lsl)")
    realtime_option(run)
    analyse = folder("analyse", "Analyse a study: table, fits, contrasts, effect sizes, and what was left out.")
    analyse.add_argument("--measure", metavar="NAME", help="another measure than the plan's primary one, which is "
                         "shown if left out")
    plot_option(analyse, "people.png")
    unblind = folder("unblind", "Show which letter is which condition, and write down who looked, and when.")
    unblind.add_argument("--name", metavar="WHO", help="who looks; left out: the user's name")
    rerun = folder("rerun", "Run a trial's hand under another law, with the trial's knobs, once a study is unblinded.")
    rerun.add_argument("--trial", metavar="SUB/N", required=True, help="the trial, as sub-03/7")
    rerun.add_argument("--law", metavar="LAW", help="the law, a name or FILE.py:CLASS; left out: the "
                       "trial's own run, in the files of its two ends")
    out_option(rerun, "NAME-rerun")
