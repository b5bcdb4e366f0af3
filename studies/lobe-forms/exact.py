"""The two lobes in 50-digit arithmetic: on paper, all forms of a lobe are one function. All vectors are unit vectors."""

from mpmath import exp

from shadelab.exact import add, dot, normalize


def power(n, h, q):
    return dot(n, h) ** q


def power_of_lights(n, l, v, q):
    return power(n, normalize(add(l, v)), q)


def beckmann(n, h, m):
    c2 = dot(n, h) ** 2
    return exp((1 - 1 / c2) / m**2) / (m**2 * c2**2)


def beckmann_of_lights(n, l, v, m):
    return beckmann(n, normalize(add(l, v)), m)


power_std = power_own = power_log = power_cross = power_distance = power
power_std_lv = power_own_lv = power_log_lv = power_cross_lv = power_distance_lv = power_of_lights
beckmann_cosine = beckmann_angle = beckmann_cross = beckmann_distance = beckmann
beckmann_cosine_lv = beckmann_angle_lv = beckmann_cross_lv = beckmann_distance_lv = beckmann_of_lights
