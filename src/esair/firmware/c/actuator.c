static const ${type} safe_${name} = ${safe};
static bool send_${name}(const void *command) { return write_${name}(*(const ${type} *)command); }
static bool still_${name}(const void *command) { return ${still}; }

static inline ${type} fit_${name}(${type} command)
{
    ${checks}
    return command;
}

