#define R(x) ((real)(x))
#ifdef ROBOT_FLOAT
#define M(name) name##f
#else
#define M(name) name
#endif

/* Numbers with a fraction, as Python has them: division by zero and what is not defined
   are faults. */

ES_SHARED real es_div(real a, real b)
{
    if (b == 0) es_fail();
    return a / b;
}

ES_SHARED real es_mod_real(real a, real b) /* has the sign of b */
{
    if (b == 0) es_fail();
    real rest = M(fmod)(a, b);
    if (rest == 0) return M(copysign)(0, b);
    return (b < 0) != (rest < 0) ? rest + b : rest;
}

ES_SHARED real es_floordiv_real(real a, real b)
{
    if (b == 0) es_fail();
    real rest = M(fmod)(a, b), times = (a - rest) / b;
    if (rest != 0 && (b < 0) != (rest < 0)) times -= 1;
    if (times == 0) return M(copysign)(0, a / b);
    real whole = M(floor)(times);
    return times - whole > R(0.5) ? whole + 1 : whole;
}

ES_SHARED int32_t es_int(real a) /* towards zero */
{
    real whole = M(trunc)(a);
    if (!(whole >= R(-2147483648.0) && whole < R(2147483648.0))) es_fail();
    return (int32_t)whole;
}

ES_SHARED int32_t es_round(real a) /* halves to even */
{
    real whole = M(round)(a);
    if (M(fabs)(a - whole) == R(0.5)) whole = 2 * M(round)(a / 2);
    return es_int(whole);
}

static inline real es_min_real(real a, real b) { return b < a ? b : a; }
static inline real es_max_real(real a, real b) { return b > a ? b : a; }


ES_SHARED real es_less_real(real a, real most, real safe)
{
    if (a == most || a == safe) return a;
    return most < safe ? (most < a && a < safe ? a : most) : safe < a && a < most ? a : most;
}

/* What a function of math has returned: of numbers it is a number. */
ES_SHARED real es_math(real result, real a)
{
    if ((isnan(result) && !isnan(a)) || (isinf(result) && isfinite(a))) es_fail();
    return result;
}
