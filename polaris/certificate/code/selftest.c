/* Self-test of @PREFIX@.c: returns 0 if every answer is the expected one, to the last bit. */
#include "@PREFIX@.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

typedef struct {
    int32_t start; /* a flight begins with this call: 1 of the schedule, 2 of the online monitor */
    @PREFIX@_input input;
    @PREFIX@_output expected;
} vector;

@VECTORS@

int main(void)
{
    @PREFIX@_memory memory;
#ifdef @GUARD@_LAGS
    @PREFIX@_online online;
    int32_t decided = 0; /* 1 where the online monitor flies */
#endif
    @PREFIX@_output output;
    int wrong = 0;
    const int count = (int)(sizeof(vectors) / sizeof(vectors[0]));
    for (int i = 0; i < count; i++) {
        const vector *const one = &vectors[i];
#ifdef @GUARD@_LAGS
        if (one->start != 0) {
            decided = (one->start == 2) ? 1 : 0;
            @PREFIX@_online_start(&online);
            online.safe.last = one->input.period - 1; /* the safety controller has flown until then */
        }
        if (decided != 0) {
            @PREFIX@_online_step(&online, &one->input, &output);
        }
        else
#endif
        {
            if (one->start != 0) {
                @PREFIX@_start(&memory);
            }
            @PREFIX@_step(&memory, &one->input, &output);
        }
        if ((output.mode != one->expected.mode) || (output.fault != one->expected.fault) ||
            (memcmp(output.command, one->expected.command, sizeof(output.command)) != 0) ||
            (memcmp(&output.margin, &one->expected.margin, sizeof(output.margin)) != 0)) {
            (void)printf("vector %d differs\n", i);
            wrong = 1;
        }
    }
    (void)printf("%d vectors, %s\n", count, (wrong == 0) ? "all as expected" : "FAILED");
    return wrong;
}
