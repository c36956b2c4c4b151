"""Experiments with people: `teleop study`, from a plan to a table and its analysis.

plan.py (what is asked), schedule.py and adaptive.py (what comes next), felt.py (what of a wall comes through a law),
session.py and journal.py (what is kept), study.py (the folder), simulated.py (people that are made up), fit.py,
contrasts.py, scores.py and analysis.py (what it says), recovery.py (whether the analysis can be relied on), plot.py,
trials (a session with a person), command.py.

A session is a loop over the journal; whoever shows the trials to a person calls, in this order:

    plan = read_plan(path); check_lock(path, plan)          # `plan` and `study`: a changed plan is refused
    study = create_study(plan, out, entropy=...)            # or open_study(out, plan, simulated=False)
    study.check_code(participant, code)                     # a code that another participant has is refused
    with study.journal(participant) as journal:             # locked; what a cut left of a last line is gone
        if not journal.rows:
            journal.append(session_row(plan, participant, code))
        while (step := next_step(plan, study.key.felt, participant, journal.rows)).kind is not StepKind.END:
            # TRIAL: step.trial; its intervals are `intervals(study, step.trial)`, knobs for load_scene(plan.scene, ...)
            journal.append(trial_row(plan, step.trial, TrialOutcome(...)))
            # BREAK: step.seconds;                            journal.append(break_row(step, seconds))
            # QUESTION: plan.questions[step.question];        journal.append(answer_row(plan, step, answers))
    study.write_tables()                                    # after each session; study.withdraw(participant) too

The records of a trial's intervals go into `study.records(participant, trial)`, folders that `load_scene(hand=...)`
takes. Where one is there and the journal has no line of that trial, it was cut: run again, `TrialOutcome(again=1)`.
"""
