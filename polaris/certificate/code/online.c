
/* 1 if values along some rows keep to the limits at a node of a cell. */
static int32_t kept(int32_t cell, int32_t part, int32_t lag, int32_t count,
                    const @PREFIX@_real *values, @PREFIX@_real size, @PREFIX@_real share)
{
    int32_t good = 1;
    for (int32_t r = 0; r < count; r++) {
        const @PREFIX@_real above = clearance[cell][r][0] + (clearance[cell][r][1] * (@PREFIX@_real)part);
        const @PREFIX@_real below = clearance[cell][r][2] + (clearance[cell][r][3] * (@PREFIX@_real)part);
        const @PREFIX@_real more = booked[lag][r] + (sized[lag][r] * size);
        const @PREFIX@_real least = more - values[r];
        const @PREFIX@_real most = more + values[r];
        if (!((most <= above) && (most <= (share * above)) &&
              (least <= below) && (least <= (share * below)))) {
            good = 0;
        }
    }
    return good;
}

/* Image of a vector under a matrix. */
static void moved_by(const @PREFIX@_real (*matrix)[@GUARD@_STATES], @PREFIX@_real *vector)
{
    @PREFIX@_real before[@GUARD@_STATES];
    for (int32_t j = 0; j < @GUARD@_STATES; j++) {
        before[j] = vector[j];
    }
    for (int32_t j = 0; j < @GUARD@_STATES; j++) {
        vector[j] = @ZERO@;
        for (int32_t l = 0; l < @GUARD@_STATES; l++) {
            vector[j] += matrix[j][l] * before[l];
        }
    }
}

/* 1 if the safety controller can take over at the next node, whatever flies until then. */
static int32_t recoverable(int32_t node, const @PREFIX@_real *state, @PREFIX@_real share)
{
    @PREFIX@_real gap[@GUARD@_STATES];
    gap_of(node / @GUARD@_PARTS, node % @GUARD@_PARTS, state, gap);
    int32_t good = 1;
    @PREFIX@_real size = @ZERO@; /* of the error, as a share of the largest */
    for (int32_t j = 0; j < @GUARD@_STATES; j++) {
        const @PREFIX@_real part_of = ((gap[j] < @ZERO@) ? -gap[j] : gap[j]) / apart[j];
        if (part_of > size) {
            size = part_of;
        }
    }
    if (size > @ONE@) {
        good = 0;
    }
    for (int32_t lag = 0; lag < @GUARD@_LAGS; lag++) {
        @PREFIX@_real values[@GUARD@_KINDS];
        const int32_t cell = (node + lag) / @GUARD@_PARTS;
        const int32_t part = (node + lag) % @GUARD@_PARTS;
        for (int32_t r = 0; r < @GUARD@_KINDS; r++) {
            values[r] = @ZERO@;
            for (int32_t j = 0; j < @GUARD@_STATES; j++) {
                values[r] += rows[r][j] * gap[j];
            }
        }
        if (kept(cell, part, lag, @GUARD@_KINDS, values, size, share) == 0) {
            good = 0;
        }
        if ((part == 0) && (cell > 0)) { /* the cell that ends here, too */
            if (kept(cell - 1, @GUARD@_PARTS, lag, @GUARD@_FACETS, values, size, share) == 0) {
                good = 0;
            }
        }
        if (lag > 0) {
            moved_by(loop, gap);
        } else {
            moved_by(held, gap);
            for (int32_t j = 0; j < @GUARD@_STATES; j++) {
                for (int32_t l = 0; l < @GUARD@_INPUTS; l++) {
                    gap[j] += force[j][l] * feed[node / @GUARD@_PARTS][l];
                }
            }
        }
    }
    return good;
}

void @PREFIX@_online_start(@PREFIX@_online *memory)
{
    @PREFIX@_start(&memory->safe);
    memory->flown = 0;
    memory->lost = 0;
    memory->answer = memory->safe.answer;
}

void @PREFIX@_online_step(@PREFIX@_online *memory, const @PREFIX@_input *input, @PREFIX@_output *output)
{
    if ((input->period >= 0) && (input->period == memory->safe.last)) {
        *output = memory->answer;
        output->fault |= @GUARD@_REPEATED;
    } else {
        @PREFIX@_input alone = *input;
        alone.controller = 0;
        @PREFIX@_step(&memory->safe, &alone, output);
        output->fault &= ~(@GUARD@_COMMAND | @GUARD@_LATCHED);
        if ((output->fault & (@GUARD@_MISSED | @GUARD@_CLOCK)) != 0U) {
            memory->lost = 1;
        }
        output->fault |= (memory->lost != 0) ? @GUARD@_LATCHED : 0U;
        const @PREFIX@_real share = ((memory->flown != 0) || (memory->safe.last == 0)) ? @ONE@ : @KEEP@;
        memory->flown = 0;
        if (input->controller > 0) {
            if (plausible(input->command, @GUARD@_INPUTS, @MOST@) == 0) {
                output->fault |= @GUARD@_COMMAND;
            } else if ((output->fault & ~@GUARD@_CLIPPED) == 0U) {
                if ((memory->safe.last < (@GUARD@_STEPS * @GUARD@_PARTS)) &&
                    (recoverable(memory->safe.last, memory->safe.state, share) != 0)) {
                    memory->flown = input->controller;
                    output->mode = input->controller;
                    output->fault = 0U;
                    answer(input->command, output);
                } else {
                    output->fault |= @GUARD@_REFUSED;
                }
            } else {
                /* the safety controller flies for the reason that the answer has */
            }
        }
        memory->answer = *output;
    }
}
