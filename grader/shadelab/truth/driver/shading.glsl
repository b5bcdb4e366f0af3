Real driver_exp(Real x) {
    return exp(x);
}

Real driver_log(Real x) {
    return log(x);
}

Real driver_pow5(Real x) {
    return pow(x, 5.0);
}

Real driver_sin(Real x) {
    return sin(x);
}

Real driver_inversesqrt(Real x) {
    return inversesqrt(x);
}
