static ${type} in_${name};

static bool take_${name}(void)
{
    ${type} value = ${empty};
    if (!read_${name}(&value)) return false;
    ${test}
    in_${name} = value;
    return true;
}

