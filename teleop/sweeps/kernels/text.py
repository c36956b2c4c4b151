"""The lines of a kernel that a single run has not, or has otherwise: see `teleop.simulation.tick` for how to read them.

A kernel keeps running figures in place of a record. Plain Python keeps them, and the messages on their way, in lists;
compiled code in the rings of `teleop.sweeps.kernels.rings`, and where eight scenes stand side by side each leaves the
run at a tick of its own.
"""

from __future__ import annotations

SUMS = """
x_err_sq = 0.0; x_err_max = 0.0                                #? x_err
old_x@ = [0.0] * (lag_x + 1)                                   #? x_err !compiled
old_x@ = ring(x_m@, size)                                      #? x_err compiled
f_err_sq = 0.0; f_err_max = 0.0                                #? f_err
old_f@ = [0.0] * (lag_f + 1)                                   #? f_err !compiled
old_f@ = ring(x_m@, size)                                      #? f_err compiled
f_m_max = 0.0                                                  #? f_m_max
f_s_max = 0.0                                                  #? f_s_max
f_h_max = 0.0                                                  #? f_h_max
f_env_max = 0.0                                                #? f_env_max
E_link = 0.0; E_link_min = inf                                 #? waves
E_port = 0.0; E_port_min = inf                                 #? energy
g_m_min = 1.0; g_s_min = 1.0                                   #? watchdog
alive = within({zero}, inf)                                    #? lanes
"""

MEASURE = """
[TRACKING]
err = magnitude(<<d_x@>>); x_err_sq = x_err_sq + err * err; x_err_max = most(x_err_max, err)  #? x_err
err = magnitude(<<d_f@>>); f_err_sq = f_err_sq + err * err; f_err_max = most(f_err_max, err)  #? f_err
f_m_max = most(f_m_max, magnitude(<<f_m@>>))                   #? f_m_max
f_s_max = most(f_s_max, magnitude(<<f_s@>>))                   #? f_s_max
f_h_max = most(f_h_max, magnitude(<<f_h@>>))                   #? f_h_max
f_env_max = most(f_env_max, magnitude(<<f_env@>>))             #? f_env_max
E_link = (E_in_fwd - E_out_fwd) + (E_in_bwd - E_out_bwd); E_link_min = least(E_link_min, E_link)  #? waves
E_port = E_port_m - E_port_s; E_port_min = least(E_port_min, E_port)  #? energy slave
E_port = E_port_m; E_port_min = least(E_port_min, E_port)      #? energy alone
g_m_min = least(g_m_min, g_m); g_s_min = least(g_s_min, g_s)   #? watchdog
"""

# Errors against the other end of `lag` ticks ago, 0 before there is one.
TRACKING = """
old_x@[k % (lag_x + 1)] = x_m@; n_x = k + 1 - lag_x            #? x_err
d_x@ = x_s@ - old_x@[(k - lag_x) % (lag_x + 1)] if k >= lag_x else 0.0  #? x_err
old_f@[k % (lag_f + 1)] = f_env@; n_f = k + 1 - lag_f          #? f_err
d_f@ = f_m@ - old_f@[(k - lag_f) % (lag_f + 1)] if k >= lag_f else 0.0  #? f_err
"""

COMPILED_TRACKING = """
sent(old_x@, k, x_m@); then = ago(k, lag_x); n_x = whole(ago(k + 1, lag_x))  #? x_err
d_x@ = where(came(then), x_s@ - received(old_x@, then, x_s@), 0.0)  #? x_err
sent(old_f@, k, f_env@); then = ago(k, lag_f); n_f = whole(ago(k + 1, lag_f))  #? f_err
d_f@ = where(came(then), f_m@ - received(old_f@, then, f_m@), 0.0)  #? f_err
"""

COMPILED_RINGS = """
ring_m@ = ring(rx_s@, size); ring_s@ = ring(rx_m@, size)
"""

COMPILED_DELIVER = """
seq = packet(play_m, k); got_m = came(seq)
newest_m = where(got_m, seq, newest_m)                         #? newest_m
rx_m@ = received(ring_s@, seq, rx_m@)
seq = packet(play_s, k); got_s = came(seq)
newest_s = where(got_s, seq, newest_s)                         #? newest_s
rx_s@ = received(ring_m@, seq, rx_s@)
"""

COMPILED_SEND = """
sent(ring_m@, k, tx_m@); sent(ring_s@, k, tx_s@)
"""

BOUNDS = """
near = alive
near = near & within(x_m@, x_limit)
near = near & within(x_s@, x_limit)                            #? slave
if some(alive & ~near):
    tell(out, alive & ~near, -(k + 1), {measured})
    alive = near
    if not some(alive): break
    x_m@ = where(alive, x_m@, nan)  # what is lost moves no more, and costs no more
    x_s@ = where(alive, x_s@, nan)                             #? slave
"""

PLAIN = {"SUMS": SUMS, "MEASURE": MEASURE, "TRACKING": TRACKING}
COMPILED = {"SUMS": SUMS, "MEASURE": MEASURE, "TRACKING": COMPILED_TRACKING, "RINGS": COMPILED_RINGS,
            "DELIVER": COMPILED_DELIVER, "SEND": COMPILED_SEND, "BOUNDS": BOUNDS}
