/* Stub of the parts of cFE that the application calls. */
#ifndef CFE_H
#define CFE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef int32_t int32;
typedef uint32_t uint32;
typedef uint8_t uint8;
typedef uint16_t uint16;
typedef int32 CFE_Status_t;
typedef uint32 CFE_SB_PipeId_t;
typedef uint32 CFE_SB_MsgId_t;
typedef int32 CFE_TBL_Handle_t;
typedef size_t CFE_MSG_Size_t;
typedef struct {
    CFE_SB_MsgId_t Id;
    uint32 Size;
} CFE_MSG_Message_t;
typedef struct {
    CFE_MSG_Message_t Msg;
} CFE_MSG_CommandHeader_t;
typedef struct {
    CFE_MSG_Message_t Msg;
    uint32 Time[2];
} CFE_MSG_TelemetryHeader_t;
typedef union {
    CFE_MSG_Message_t Msg;
    double Align;
} CFE_SB_Buffer_t;
typedef int32 (*CFE_TBL_CallbackFuncPtr_t)(void *Image);

#define CFE_MSG_PTR(header) (&((header).Msg))
#define CFE_SUCCESS (0)
#define CFE_TBL_INFO_UPDATED (1)
#define CFE_SB_INVALID_MSG_ID (0U)
#define CFE_SB_PEND_FOREVER (-1)
#define CFE_TBL_OPT_DEFAULT (0U)
#define CFE_EVS_EventFilter_BINARY (0U)
#define CFE_EVS_EventType_INFORMATION (2U)
#define CFE_EVS_EventType_ERROR (3U)
enum { CFE_ES_RunStatus_APP_RUN = 1, CFE_ES_RunStatus_APP_EXIT, CFE_ES_RunStatus_APP_ERROR };
typedef enum { CFE_TBL_SRC_FILE } CFE_TBL_SrcEnum_t;

CFE_Status_t CFE_EVS_Register(const void *Filters, uint16 Count, uint16 Scheme);
CFE_Status_t CFE_EVS_SendEvent(uint16 Id, uint16 Type, const char *Spec, ...);
CFE_Status_t CFE_ES_WriteToSysLog(const char *Spec, ...);
bool CFE_ES_RunLoop(uint32 *RunStatus);
void CFE_ES_ExitApp(uint32 ExitStatus);
CFE_Status_t CFE_MSG_Init(CFE_MSG_Message_t *Msg, CFE_SB_MsgId_t Id, CFE_MSG_Size_t Size);
CFE_Status_t CFE_MSG_GetMsgId(const CFE_MSG_Message_t *Msg, CFE_SB_MsgId_t *Id);
CFE_Status_t CFE_MSG_GetSize(const CFE_MSG_Message_t *Msg, CFE_MSG_Size_t *Size);
CFE_SB_MsgId_t CFE_SB_ValueToMsgId(uint32 Value);
uint32 CFE_SB_MsgIdToValue(CFE_SB_MsgId_t Id);
CFE_Status_t CFE_SB_CreatePipe(CFE_SB_PipeId_t *Pipe, uint16 Depth, const char *Name);
CFE_Status_t CFE_SB_Subscribe(CFE_SB_MsgId_t Id, CFE_SB_PipeId_t Pipe);
CFE_Status_t CFE_SB_ReceiveBuffer(CFE_SB_Buffer_t **Buffer, CFE_SB_PipeId_t Pipe, int32 TimeOut);
void CFE_SB_TimeStampMsg(CFE_MSG_Message_t *Msg);
CFE_Status_t CFE_SB_TransmitMsg(const CFE_MSG_Message_t *Msg, bool Count);
CFE_Status_t CFE_TBL_Register(CFE_TBL_Handle_t *Handle, const char *Name, size_t Size, uint16 Options,
                              CFE_TBL_CallbackFuncPtr_t Validate);
CFE_Status_t CFE_TBL_Load(CFE_TBL_Handle_t Handle, CFE_TBL_SrcEnum_t Source, const void *File);
CFE_Status_t CFE_TBL_Manage(CFE_TBL_Handle_t Handle);
CFE_Status_t CFE_TBL_GetAddress(void **Image, CFE_TBL_Handle_t Handle);
CFE_Status_t CFE_TBL_ReleaseAddress(CFE_TBL_Handle_t Handle);

#endif
