#define @GUARD@_STATE 0x01U    /* estimate not finite or implausible: last one used */
@PART@
    @PREFIX@_real state[@GUARD@_STATES];   /* estimate at the start of the period */
@PART@
@PART@
@PART@
/* Take in the estimate of a call. */
static uint32_t estimate(@PREFIX@_memory *memory, const @PREFIX@_input *input)
{
    uint32_t fault = 0U;
    if (plausible(input->state, @GUARD@_STATES, @GUARD@_FARTHEST) != 0) {
        for (int32_t j = 0; j < @GUARD@_STATES; j++) {
            memory->state[j] = input->state[j];
        }
    } else {
        fault = @GUARD@_STATE;
    }
    return fault;
}

