"""Runs written down by hand, for the tests of tables and training rows."""

from pgf_jax.tables.run_log import RunLog


def log(scene="a", seed=0, n_objects=20):
    return RunLog(scene=scene, seed=seed, scene_class="tight", n_objects=n_objects)


def reach(run, costs, *, solved_last=False):
    """Iterations whose whole cost is c_d."""
    for i, cost in enumerate(costs):
        run.add((cost, 0.0, 0.0), feasible=solved_last and i == len(costs) - 1)


def push(run, iterations, *, feasible):
    run.input_given()
    run.begin_segment("push")
    for i in range(iterations):
        run.add((7.0, 0.0, 0.0), feasible=feasible and i == iterations - 1)


def helped_run():
    """Three inputs: a push that succeeds, go on reaching, a push that is dropped."""
    run = log()
    run.begin_segment("reach")
    reach(run, [900, 890, 880, 870, 860])  # iterations 0..4; counted 1..4
    push(run, 2, feasible=True)  # 5, 6
    run.begin_segment("reach")
    reach(run, [800, 790, 780, 770, 760])  # 7..11; counted 5..8
    run.input_given()  # go on
    reach(run, [750, 740, 730])  # 12..14; counted 9..11
    push(run, 3, feasible=False)  # 15..17
    run.begin_segment("reach")
    reach(run, [810, 700, 690, 680, 670, 15], solved_last=True)  # 18..23; counted 12..16
    return run
