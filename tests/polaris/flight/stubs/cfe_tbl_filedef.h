/* Stub of cFE's definition of table files. */
#include "cfe.h"

typedef struct {
    char ObjectName[64];
    char TableName[38];
    char Description[32];
    char TargetFile[20];
    size_t ObjectSize;
} CFE_TBL_FileDef_t;
extern const CFE_TBL_FileDef_t CFE_TBL_FileDef;
#define CFE_TBL_FILEDEF(object, name, text, file) \
    const CFE_TBL_FileDef_t CFE_TBL_FileDef = {#object, #name, #text, #file, sizeof(object)};
