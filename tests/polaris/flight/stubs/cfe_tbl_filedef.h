/* Stub of cFE's definition of table files. */
#include "cfe.h"

typedef struct {
    char ObjectName[64];
    char TableName[40];
    char Description[32];
    char TargetFile[20];
    size_t ObjectSize;
} CFE_TBL_FileDef_t;
extern const CFE_TBL_FileDef_t CFE_TBL_FileDef;
#define CFE_TBL_FILEDEF(object, name, text, file) \
    const CFE_TBL_FileDef_t CFE_TBL_FileDef = {#object "\0", #name "\0", #text "\0", #file "\0", sizeof(object)};
