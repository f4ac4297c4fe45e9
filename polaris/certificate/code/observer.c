#define @GUARD@_STATE 0x01U    /* first estimate implausible, or more periods without a measurement than declared */
#define @GUARD@_PREDICTED 0x400U /* no measurement that can be used: the state is predicted, as declared */
#define @GUARD@_OUTPUTS (@OUTPUTS@)  /* of a measurement */
#define @GUARD@_SENT (@SENT@)     /* commands that a measurement does not show, at least one */
#define @GUARD@_UPDATES (@UPDATES@)  /* gains: after 0, 1, ... periods without a measurement */
@PART@
    @PREFIX@_real state[@GUARD@_STATES];   /* first estimate, as predicted for now: read in the first call */
    @PREFIX@_real measured[@GUARD@_OUTPUTS]; /* measurement for this period, NaN if there is none */
@PART@
    @PREFIX@_real sent[@GUARD@_SENT][@GUARD@_INPUTS]; /* commands; after the start those before it, newest first */
    int32_t newest; /* of these commands */
    int32_t unseen; /* periods since a measurement, as many as may be at most */
@PART@
    memory->newest = 0;
    memory->unseen = 0;
    for (int32_t i = 0; i < @GUARD@_SENT; i++) {
        for (int32_t l = 0; l < @GUARD@_INPUTS; l++) {
            memory->sent[i][l] = @ZERO@;
        }
    }
@PART@
/* The state of now, predicted from that of the period before under the command that was applied. */
static void predict(@PREFIX@_memory *memory, @PREFIX@_real *next)
{
    memory->newest = (memory->newest + (@GUARD@_SENT - 1)) % @GUARD@_SENT;
    for (int32_t l = 0; l < @GUARD@_INPUTS; l++) {
        memory->sent[memory->newest][l] = memory->answer.command[l];
    }
    for (int32_t j = 0; j < @GUARD@_STATES; j++) {
        next[j] = @ZERO@;
        for (int32_t l = 0; l < @GUARD@_STATES; l++) {
            next[j] += held[j][l] * memory->state[l];
        }
        for (int32_t l = 0; l < @GUARD@_INPUTS; l++) {
            next[j] += force[j][l] * memory->answer.command[l];
        }
    }
}

/* Correct a predicted state by a measurement; returns what is wrong with that. */
static uint32_t correct(const @PREFIX@_memory *memory, const @PREFIX@_real *measured, @PREFIX@_real *next)
{
    uint32_t fault = 0U;
    @PREFIX@_real off[@GUARD@_OUTPUTS];
    for (int32_t o = 0; o < @GUARD@_OUTPUTS; o++) {
        off[o] = measured[o];
        for (int32_t l = 0; l < @GUARD@_STATES; l++) {
            off[o] -= seen[o][l] * next[l];
        }
        for (int32_t i = 0; i < @GUARD@_SENT; i++) {
            const int32_t age = (memory->newest + i) % @GUARD@_SENT;
            for (int32_t l = 0; l < @GUARD@_INPUTS; l++) {
                off[o] += later[i][o][l] * memory->sent[age][l];
            }
        }
        if (plausible(&measured[o], 1, heard[o]) == 0) {
            fault = @GUARD@_RANGE;
        }
    }
    for (int32_t j = 0; j < @GUARD@_STATES; j++) {
        for (int32_t o = 0; o < @GUARD@_OUTPUTS; o++) {
            next[j] += updates[memory->unseen][j][o] * off[o];
        }
    }
    return fault;
}

/* The estimate of a call: the first one as it is handed over, later ones by the observer. */
static uint32_t estimate(@PREFIX@_memory *memory, const @PREFIX@_input *input)
{
    uint32_t fault = 0U;
    @PREFIX@_real next[@GUARD@_STATES];
    if (memory->last < 0) {
        for (int32_t j = 0; j < @GUARD@_STATES; j++) {
            next[j] = input->state[j];
        }
    } else {
        predict(memory, next);
        if (plausible(input->measured, @GUARD@_OUTPUTS, @GUARD@_FARTHEST) != 0) {
            fault = correct(memory, input->measured, next);
            memory->unseen = 0;
        } else if (memory->unseen < (@GUARD@_UPDATES - 1)) {
            fault = @GUARD@_PREDICTED;
            memory->unseen++;
        } else {
            fault = @GUARD@_STATE;
        }
    }
    if (plausible(next, @GUARD@_STATES, @GUARD@_FARTHEST) != 0) {
        for (int32_t j = 0; j < @GUARD@_STATES; j++) {
            memory->state[j] = next[j];
        }
    } else {
        fault |= @GUARD@_STATE;
    }
    return fault;
}

