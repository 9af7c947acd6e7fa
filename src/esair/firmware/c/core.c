/* The core of ESAIR MIN in C: it decides as esair/minimal.py does, line by line. Nothing is
   taken from a heap. A fault of a reaction jumps to where the core has called it. */

#ifdef __GNUC__
#define ES_SHARED __attribute__((unused, noinline)) static
#if __GNUC__ > 5 /* a reaction may compare a number with itself */
#pragma GCC diagnostic ignored "-Wtautological-compare"
#endif
#else
#define ES_SHARED static
#endif

typedef struct { /* when a part has its turn; a pace of 0: on each new reading */
    uint32_t age, pace, phase;
    bool slow, due; /* slow: not in each step */
} es_turn;

typedef struct { /* a sensor, and how old its reading is */
    es_turn turn;
    bool (*take)(void);
    uint8_t part;
} es_input;

typedef struct { /* a reading that a reaction uses */
    es_input *source;
    uint32_t max_age;
    bool optional, there;
} es_term;

typedef struct { /* a reaction, and how long ago its last step was */
    es_turn turn;
    void (*react)(void);
    es_term *terms;
    uint8_t n_terms, part, dark;
    bool guards, blind, started;
} es_task;

typedef struct { /* what a reaction may do with an actuator */
    es_task *task;
    struct es_output *output;
    void *command;
    uint32_t hold;
    int16_t priority, bar;
    bool asked;
} es_port;

typedef struct { /* what passes judgement on each command of an actuator */
    es_task *task;
    struct es_output *output;
    void (*react)(void), (*blind)(void);
    bool latch, latched;
} es_guard;

typedef struct es_output { /* an actuator, and whose will it does */
    bool (*send)(const void *command);
    bool (*still)(const void *command); /* it equals safe */
    bool (*lessen)(void); /* passing is no more than last; tell whether it is last */
    const void *safe;
    void *passing, *last;
    es_port *ports;
    es_guard *guards;
    uint32_t timeout, age;
    es_port *writer, *holder, *steady;
    uint16_t size;
    uint8_t n_ports, n_guards, part;
    bool stands, rests, bad, news; /* rests: what stands equals safe */
} es_output;

#define ES_OLD UINT32_C(0x40000000) /* ages end here: older than any time that can be set */
#define ES_NEVER INT16_MIN /* beyond all priorities, as is */
#define ES_ALWAYS INT16_MAX
#define ES_ROOM(n) ((n) > 0 ? (n) : 1)

static es_input es_inputs[ES_ROOM(ES_INPUTS)];
static es_term es_terms[ES_ROOM(ES_TERMS)];
static es_task es_tasks[ES_ROOM(ES_TASKS)];
static es_port es_ports[ES_ROOM(ES_PORTS)];
static es_guard es_guards[ES_ROOM(ES_GUARDS)];
static es_output es_outputs[ES_ROOM(ES_OUTPUTS)];

static jmp_buf es_catch;
static uint32_t es_now, es_rest, es_elapsed;
static bool es_ancient, es_passed, es_stopped;

static void es_fail(void) { longjmp(es_catch, 1); }

/* Integers of 32 bits: what does not fit is a fault. */

ES_SHARED int32_t es_fit(int64_t a)
{
    if (a < INT32_MIN || a > INT32_MAX) es_fail();
    return (int32_t)a;
}

ES_SHARED int32_t es_add(int32_t a, int32_t b)
{
    if (b > 0 ? a > INT32_MAX - b : a < INT32_MIN - b) es_fail();
    return a + b;
}

ES_SHARED int32_t es_sub(int32_t a, int32_t b)
{
    if (b < 0 ? a > INT32_MAX + b : a < INT32_MIN + b) es_fail();
    return a - b;
}

ES_SHARED int32_t es_mul(int32_t a, int32_t b) { return es_fit((int64_t)a * b); }
static inline int32_t es_neg(int32_t a) { return es_sub(0, a); }
static inline int32_t es_abs(int32_t a) { return a < 0 ? es_neg(a) : a; }
static inline int32_t es_min(int32_t a, int32_t b) { return b < a ? b : a; }
static inline int32_t es_max(int32_t a, int32_t b) { return b > a ? b : a; }

ES_SHARED int32_t es_less(int32_t a, int32_t most, int32_t safe) /* a, or most if it is more */
{
    return a == safe || (es_min(most, safe) <= a && a <= es_max(most, safe)) ? a : most;
}

ES_SHARED int32_t es_mod(int32_t a, int32_t b) /* has the sign of b */
{
    if (b == 0) es_fail();
    int32_t rest = b == -1 ? 0 : a % b;
    return rest != 0 && (rest < 0) != (b < 0) ? rest + b : rest;
}

ES_SHARED int32_t es_floordiv(int32_t a, int32_t b) /* towards minus infinity */
{
    if (b == 0) es_fail();
    if (b == -1) return es_neg(a);
    return a / b - (a % b != 0 && (a < 0) != (b < 0));
}

ES_SHARED int32_t es_shl(int32_t a, int32_t n)
{
    if (n < 0 || (n > 31 && a != 0)) es_fail();
    return a == 0 ? 0 : es_fit((int64_t)a * ((int64_t)1 << n));
}

ES_SHARED int32_t es_shr(int32_t a, int32_t n)
{
    if (n < 0) es_fail();
    if (n > 31) n = 31;
    return a < 0 ? ~(~a >> n) : a >> n;
}

static inline int32_t es_at(int32_t i, int32_t n)
{
    if (i < -n || i >= n) es_fail();
    return i < 0 ? i + n : i;
}

static inline int32_t es_now_ms(void)
{
    if (es_ancient) es_fail();
    return (int32_t)es_now;
}

static inline int32_t es_elapsed_ms(void) { return (int32_t)es_elapsed; } /* ES_OLD at most */

/* The loop. */

ES_SHARED void es_note(uint8_t part)
{
    robot.faults++;
    robot.fault = part;
}

static bool es_try(void (*decide)(void), uint8_t part)
{
    if (setjmp(es_catch) != 0) {
        es_note(part);
        return false;
    }
    decide();
    return true;
}

static inline void es_clock(es_task *task)
{
    es_elapsed = task->started ? task->turn.age : 0;
    task->started = true;
    task->turn.age = 0;
}

/* Send a command of somebody, or the safe one, which is tried again at each step. */
static void es_tell(es_output *o, const void *command, es_port *writer)
{
    o->writer = writer;
    o->stands = writer != NULL;
    o->bad = writer == NULL;
    o->rests = o->bad || o->still(command);
    if (o->bad) o->steady = NULL;
    else if (o->n_guards) memcpy(o->last, command, o->size);
    if (o->send(o->bad ? o->safe : command)) {
        o->bad = false;
        return;
    }
    es_note(o->part);
    if (!o->bad) {
        o->holder = NULL;
        es_tell(o, NULL, NULL);
    }
}

static bool es_passes(es_guard *g)
{
    if (g->latched) return false;
    es_passed = false;
    if (!g->task->blind) {
        es_clock(g->task);
        if (!es_try(g->react, g->task->part)) es_passed = false;
    } else if (!g->latch && g->blind != NULL) {
        if (!es_try(g->blind, g->task->part)) es_passed = false;
    }
    bool still = g->output->writer == NULL || g->output->rests;
    if (!es_passed) g->latched = g->latch && !(g->task->blind && still);
    return es_passed;
}

/* Send what the guards let pass: of a new command, or less of what stands. */
static void es_review(es_output *o, es_port *port)
{
    es_port *writer = port != NULL ? port : o->writer;
    const void *command = writer != NULL ? writer->command : NULL;
    o->news = false;
    if (writer == NULL) return;
    if (o->n_guards) {
        memcpy(o->passing, command, o->size);
        command = o->passing;
        es_stopped = false;
        es_guard *g = o->guards, *end = g + o->n_guards;
        for (; g < end; g++) /* one more keeps no latch open */
            if ((!es_stopped || g->latch) && !es_passes(g)) es_stopped = true;
        if (es_stopped) {
            if (port != NULL) robot.refused++;
            o->writer = NULL;
            return;
        }
        if (port == NULL && o->lessen()) return;
    }
    es_tell(o, command, writer);
}

/* Do the will of the best who asks. */
static void es_settle(es_output *o, uint32_t late)
{
    if (o->bad) es_tell(o, NULL, NULL);
    if (o->bad) return;
    es_port *holder = o->holder, *best = NULL;
    uint32_t age = o->age - late;
    int16_t bar = robot.armed ? ES_NEVER : ES_ALWAYS;
    bool over = holder == NULL || age >= holder->hold;
    o->steady = NULL;
    for (int i = 0; i < o->n_ports; i++) {
        es_port *port = &o->ports[i];
        if (port->task->blind) {
            if (port->bar > bar) bar = port->bar;
            if (port == o->writer) o->writer = NULL;
            if (port == holder) holder = NULL;
        } else if (port->asked && (best == NULL
                   || (port == holder && !over && port->priority == best->priority)))
            best = port;
    }
    if (bar > ES_NEVER && o->writer != NULL && !o->rests
        && (holder == NULL || age > holder->hold || holder->priority <= bar)) {
        holder = o->writer = NULL;
        es_guard *g = o->guards, *end = g + o->n_guards;
        for (; g < end; g++) g->latched |= g->latch && g->task->blind; /* it moved till now */
    }
    bool still = best != NULL && best->priority <= bar && o->still(best->command);
    if (still) bar = ES_NEVER; /* what is safe passes who is blind, and holds nothing */
    if (over) holder = NULL;
    else if (holder != NULL && best != holder && holder->priority > bar) bar = holder->priority;
    o->holder = holder;
    if (best == NULL || best->priority <= bar) {
        if (best != NULL) robot.refused++;
        best = NULL;
        still = false;
    } else if (!still) {
        o->holder = best;
        o->age = age = 0;
        if (!o->n_guards) o->steady = best;
    }
    if (age >= o->timeout) o->writer = NULL; /* before a guard looks at what it stopped */
    if (still) es_tell(o, o->safe, o->writer);
    else if (best != NULL || (o->news && !o->rests)) es_review(o, best);
    if (o->stands && o->writer == NULL) es_tell(o, NULL, NULL);
}

/* Let what a reaction writes or guards be looked at closely. */
static void es_wake(es_task *task)
{
    for (int i = 0; i < ES_PORTS; i++)
        if (es_ports[i].task == task) {
            es_ports[i].asked = false;
            es_ports[i].output->steady = NULL;
        }
    for (int i = 0; i < ES_GUARDS; i++)
        if (es_guards[i].task == task) {
            es_guards[i].output->steady = NULL;
            es_guards[i].output->news = true;
        }
}

static void es_lose_sight(es_task *task)
{
    if (!task->blind) {
        task->blind = true;
        es_wake(task);
    }
}

/* Ask for the command that a reaction has put there, or give the actuator back. */
static inline void es_ask(es_port *port, bool some)
{
    port->asked = some;
    if (!some && port->output->holder == port) port->output->holder = NULL;
}

static inline void es_grow(uint32_t *age, uint32_t gap)
{
    uint32_t now = *age + gap;
    *age = now < ES_OLD ? now : ES_OLD;
}

/* Let a part be older by a period; its next turn may be in the step after that. */
ES_SHARED void es_pass(es_turn *turn, uint32_t gap)
{
    es_grow(&turn->age, gap);
    if (!turn->slow) return;
    turn->phase += turn->pace;
    if (turn->phase >= 2 * ES_EVERY) turn->phase -= ES_EVERY;
}

ES_SHARED void es_begin(es_turn *turn)
{
    if (!turn->slow) return;
    turn->due = turn->phase >= ES_EVERY;
    if (turn->due) turn->phase -= ES_EVERY;
}

static void es_advance(void) /* by one period */
{
    uint32_t gap = ES_GAP;
    es_rest += ES_ODD;
    if (es_rest >= ES_EVERY) {
        es_rest -= ES_EVERY;
        gap++;
    }
    es_now += gap;
    if (es_now > INT32_MAX) es_ancient = true;
    for (es_input *s = es_inputs; s < es_inputs + ES_INPUTS; s++) es_pass(&s->turn, gap);
    for (es_task *t = es_tasks; t < es_tasks + ES_TASKS; t++) es_pass(&t->turn, gap);
    for (es_output *o = es_outputs; o < es_outputs + ES_OUTPUTS; o++) es_grow(&o->age, gap);
}

/* What was going to be blind before this step has been safe since the last one. */
static void es_end_sight(es_task *task)
{
    for (int i = 0; i < ES_PORTS; i++)
        if (es_ports[i].task == task) es_settle(es_ports[i].output, 1);
    for (int i = 0; i < ES_GUARDS; i++)
        if (es_guards[i].task == task) es_settle(es_guards[i].output, 1);
}

/* Look whether a reaction sees all that it needs; *news: whether there is a new reading. */
static bool es_sees(es_task *task, bool *news)
{
    bool at_news = task->turn.pace == 0;
    *news = !at_news && task->turn.due;
    for (es_term *term = task->terms; term < task->terms + task->n_terms; term++) {
        uint32_t age = term->source->turn.age;
        bool there = age <= term->max_age;
        if (age == 0) {
            if (at_news) *news = true;
        } else if (term->optional) {
            if (!there && term->there && at_news) *news = true;
        } else if (age + ES_GAP > term->max_age) {
            task->dark++;
            if (!there) {
                es_lose_sight(task);
                return false;
            }
        }
        term->there = there || age == 0;
    }
    return true;
}

static void es_decide(es_task *task)
{
    bool news;
    if (!es_sees(task, &news)) return;
    if (!news && !(task->guards && task->blind)) {
        if (task->blind) task->dark++;
        return;
    }
    task->blind = false;
    if (task->guards) {
        es_wake(task);
        return;
    }
    es_clock(task);
    if (!es_try(task->react, task->part)) {
        es_lose_sight(task);
        task->dark++;
    }
}

void robot_step(void)
{
    for (es_input *s = es_inputs; s < es_inputs + ES_INPUTS; s++) es_begin(&s->turn);
    for (es_task *t = es_tasks; t < es_tasks + ES_TASKS; t++) es_begin(&t->turn);
    for (es_task *t = es_tasks; t < es_tasks + ES_TASKS; t++)
        if (t->dark > 0) es_lose_sight(t);
    for (es_task *t = es_tasks; t < es_tasks + ES_TASKS; t++)
        for (; t->dark > 0; t->dark--) es_end_sight(t);
    for (es_input *s = es_inputs; s < es_inputs + ES_INPUTS; s++)
        if (s->turn.due) {
            if (s->take()) s->turn.age = 0;
            else es_note(s->part);
        }
    for (es_task *t = es_tasks; t < es_tasks + ES_TASKS; t++) es_decide(t);
    for (es_output *o = es_outputs; o < es_outputs + ES_OUTPUTS; o++) {
        es_port *best = NULL;
        for (es_port *p = o->ports; p < o->ports + o->n_ports; p++)
            if (p->asked && best == NULL) best = p;
            else robot.refused += p->asked;
        if (best == NULL || best != o->steady) {
            es_settle(o, 0);
            continue;
        }
        o->age = 0;
        o->rests = o->still(best->command);
        if (!o->send(best->command)) {
            es_note(o->part);
            o->holder = NULL;
            es_tell(o, NULL, NULL);
        }
    }
    for (int i = 0; i < ES_PORTS; i++) es_ports[i].asked = false;
    robot.steps++;
    es_advance();
}

void robot_skip(uint32_t steps)
{
    robot.late += steps;
    for (; steps > 0; steps--) es_advance();
}

uint32_t robot_wait(uint32_t clock)
{
    int32_t left = (int32_t)(es_now - clock);
    for (; left <= -(int32_t)(ES_GAP + (ES_ODD > 0)); left = (int32_t)(es_now - clock)) robot_skip(1);
    return left > 0 ? (uint32_t)left : 0;
}

void robot_open(void)
{
    (void)es_terms; /* a robot may have none */
    es_now = es_rest = 0;
    es_ancient = false;
    for (int i = 0; i < ES_INPUTS; i++) es_inputs[i].turn.age = ES_OLD;
    for (int i = 0; i < ES_TASKS; i++) {
        es_tasks[i].started = es_tasks[i].blind = false;
        es_tasks[i].dark = 0;
        es_lose_sight(&es_tasks[i]);
    }
    for (int i = 0; i < ES_OUTPUTS; i++) {
        es_outputs[i].holder = NULL;
        es_outputs[i].age = 0;
        es_tell(&es_outputs[i], NULL, NULL);
    }
}

void robot_close(void)
{
    for (int i = 0; i < ES_OUTPUTS; i++) es_outputs[i].bad = true;
    for (int i = 0; i < 3 * ES_OUTPUTS; i++) {
        es_output *o = &es_outputs[i % ES_ROOM(ES_OUTPUTS)];
        if (o->bad) es_tell(o, NULL, NULL);
    }
}

void robot_arm(bool armed)
{
    robot.armed = armed;
    for (int i = 0; i < ES_OUTPUTS; i++) es_outputs[i].steady = NULL;
}

bool robot_reset(uint8_t part)
{
    for (int i = 0; i < ES_GUARDS; i++)
        if (es_guards[i].task->part == part) {
            es_guards[i].latched = es_guards[i].latched && es_guards[i].task->blind;
            return !es_guards[i].latched;
        }
    return false;
}
