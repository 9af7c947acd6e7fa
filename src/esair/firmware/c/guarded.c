static ${type} pass_${name}, last_${name};

static ${type} less_${name}(${type} value, ${type} most)
{
    ${less}
    return value;
}

static bool lessen_${name}(void)
{
    pass_${name} = less_${name}(pass_${name}, last_${name});
    return ${is_last};
}

static void let_${name}(${type} wish)
{
    es_passed = true;
    if (memcmp(&wish, &pass_${name}, sizeof wish) == 0) return; /* all of it */
    const ${type} passed = fit_${name}(wish);
    const ${type} less = less_${name}(passed, pass_${name});
    if (!(${is_less})) es_fail(); /* more than was asked */
    if (!es_stopped) pass_${name} = passed;
}

