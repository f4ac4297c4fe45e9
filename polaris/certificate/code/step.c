/* See @PREFIX@.h. Compile with -std=c99 -ffp-contract=off, without -ffast-math. */
/* A call takes at most @PRODUCTS@ products, @SUMS@ sums and @QUOTIENTS@ quotients, each in a loop of constant length. */
#include "@PREFIX@.h"

#include <float.h>

#if !defined(FLT_EVAL_METHOD) || (FLT_EVAL_METHOD != 0)
#error "intermediate results must be rounded to their type"
#endif

@TABLES@

static int32_t plausible(const @PREFIX@_real *values, int32_t count, @PREFIX@_real most)
{
    int32_t good = 1;
    for (int32_t i = 0; i < count; i++) {
        if (!((values[i] >= -most) && (values[i] <= most))) { /* true for NaN */
            good = 0;
        }
    }
    return good;
}

/* The reference at a node less a state. */
static void gap_of(int32_t cell, int32_t part, const @PREFIX@_real *state, @PREFIX@_real *gap)
{
    for (int32_t j = 0; j < @GUARD@_STATES; j++) {
        @PREFIX@_real reference = @ZERO@;
        for (int32_t l = 0; l < @GUARD@_STATES; l++) {
            reference += moved[part][j][l] * waypoints[cell][l];
        }
        if (cell < @GUARD@_STEPS) {
            for (int32_t l = 0; l < @GUARD@_INPUTS; l++) {
                reference += pushed[part][j][l] * feed[cell][l];
            }
        }
        gap[j] = reference - state[j];
    }
}

/* Command of the safety controller, before clipping. */
static void safety(int32_t cell, const @PREFIX@_real *gap, @PREFIX@_real *command)
{
    for (int32_t i = 0; i < @GUARD@_INPUTS; i++) {
        command[i] = (cell < @GUARD@_STEPS) ? feed[cell][i] : @ZERO@;
        for (int32_t j = 0; j < @GUARD@_STATES; j++) {
            command[i] += gain[i][j] * gap[j];
        }
    }
}

/* Clip a command into the answer, and say what it leaves of the limits. */
static void answer(const @PREFIX@_real *command, @PREFIX@_output *output)
{
    output->margin = @ONE@;
    for (int32_t i = 0; i < @GUARD@_INPUTS; i++) {
        @PREFIX@_real value = command[i];
        if (value > limit[i]) {
            value = limit[i];
            output->fault |= @GUARD@_CLIPPED;
        }
        if (value < -limit[i]) {
            value = -limit[i];
            output->fault |= @GUARD@_CLIPPED;
        }
        output->command[i] = value;
        const @PREFIX@_real left = @ONE@ - (((value < @ZERO@) ? -value : value) / limit[i]);
        if (left < output->margin) {
            output->margin = left;
        }
    }
}

void @PREFIX@_start(@PREFIX@_memory *memory)
{
    memory->last = -1;
    memory->latched = 0;
    for (int32_t j = 0; j < @GUARD@_STATES; j++) {
        memory->state[j] = waypoints[0][j];
    }
@START@
    memory->answer.mode = 0;
    memory->answer.fault = 0U;
    memory->answer.margin = @ONE@;
    for (int32_t i = 0; i < @GUARD@_INPUTS; i++) {
        memory->answer.command[i] = @ZERO@;
    }
}

@ESTIMATE@
/* Take in the period and the state of a call; returns what is wrong with them. */
static uint32_t receive(@PREFIX@_memory *memory, const @PREFIX@_input *input)
{
    uint32_t fault = estimate(memory, input);
    int32_t period = input->period;
    if (period < 0) { /* no number at all: the next one */
        fault |= @GUARD@_CLOCK;
        period = memory->last;
        if (period < INT32_MAX) {
            period = period + 1;
        }
    } else if (period < memory->last) {
        fault |= @GUARD@_CLOCK;
    } else if ((period - 1) > memory->last) {
        fault |= @GUARD@_MISSED;
    } else {
        /* the next period */
    }
    memory->last = period;
    return fault;
}

void @PREFIX@_step(@PREFIX@_memory *memory, const @PREFIX@_input *input, @PREFIX@_output *output)
{
    if ((input->period >= 0) && (input->period == memory->last)) {
        *output = memory->answer;
        output->fault |= @GUARD@_REPEATED;
    } else {
        uint32_t fault = receive(memory, input);
        const int32_t last = (@GUARD@_CELLS * @GUARD@_PARTS) - 1;
        const int32_t node = (memory->last > last) ? last : memory->last;
        const int32_t cell = node / @GUARD@_PARTS;
        const int32_t scheduled = (cell < @GUARD@_STEPS) ? (int32_t)modes[cell] : 0;
        if ((scheduled != 0) && ((input->controller != scheduled) ||
                                 (plausible(input->command, @GUARD@_INPUTS, @MOST@) == 0))) {
            fault |= @GUARD@_COMMAND;
        }
        if ((fault & @GUARD@_LASTING) != 0U) {
            memory->latched = 1;
        }
        output->mode = (memory->latched != 0) ? 0 : scheduled;
        fault |= (memory->latched != 0) ? @GUARD@_LATCHED : 0U;
        fault |= (memory->last >= @GUARD@_COVERED) ? @GUARD@_ENDED : 0U;
        for (int32_t j = 0; j < @GUARD@_STATES; j++) {
            if (plausible(&memory->state[j], 1, range[j]) == 0) {
                fault |= @GUARD@_RANGE;
            }
        }
        output->fault = fault;
        if (output->mode != 0) {
            answer(input->command, output);
        } else {
            @PREFIX@_real gap[@GUARD@_STATES];
            @PREFIX@_real command[@GUARD@_INPUTS];
            gap_of(cell, node % @GUARD@_PARTS, memory->state, gap);
            safety(cell, gap, command);
            answer(command, output);
        }
        memory->answer = *output;
    }
}
@ONLINE@