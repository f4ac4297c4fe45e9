
/* The online monitor decides in every control period, from the estimate, if a controller may fly it. */
#define @GUARD@_FACETS (@FACETS@)  /* rows of limits that unsafe sets have */
#define @GUARD@_KINDS (@KINDS@)   /* rows of limits, those of thrust included */
#define @GUARD@_LAGS (@LAGS@)  /* nodes that a decision looks at */
#define @GUARD@_AHEAD (@AHEAD@)  /* steps with limits that a decision looks at */
#define @GUARD@_SIDES (4)
#define @GUARD@_REFUSED 0x200U /* the safety controller might not recover after one more period */

typedef struct {
    @PREFIX@_memory safe;   /* of the safety controller */
    int32_t flown;          /* who flew in the newest period */
    int32_t lost;           /* 1 once numbers of periods contradict each other: no other controller flies */
    @PREFIX@_output answer; /* to the newest period */
} @PREFIX@_online;

void @PREFIX@_online_start(@PREFIX@_online *memory);
void @PREFIX@_online_step(@PREFIX@_online *memory, const @PREFIX@_input *input, @PREFIX@_output *output);
