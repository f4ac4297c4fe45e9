/* Stub of cFE that hands calls from the standard input to the application, and writes what it sends. */
#include "@NAME@_app.h"
#include "cfe_tbl_filedef.h"

#include <stdio.h>
#include <string.h>

extern @APP@_Table_t @APP@_Table;
static @APP@_InputMsg_t message;
static CFE_TBL_CallbackFuncPtr_t validate;
static int loaded, subscribed, events, status;

CFE_Status_t CFE_EVS_Register(const void *Filters, uint16 Count, uint16 Scheme)
{
    (void)Filters;
    return Count + Scheme;
}
CFE_Status_t CFE_EVS_SendEvent(uint16 Id, uint16 Type, const char *Spec, ...)
{
    (void)Type;
    (void)Spec;
    events |= 1 << Id;
    return CFE_SUCCESS;
}
CFE_Status_t CFE_ES_WriteToSysLog(const char *Spec, ...)
{
    (void)Spec;
    return CFE_SUCCESS;
}
bool CFE_ES_RunLoop(uint32 *RunStatus)
{
    return *RunStatus == CFE_ES_RunStatus_APP_RUN;
}
void CFE_ES_ExitApp(uint32 ExitStatus)
{
    status = (int)ExitStatus;
}
CFE_Status_t CFE_MSG_Init(CFE_MSG_Message_t *Msg, CFE_SB_MsgId_t Id, CFE_MSG_Size_t Size)
{
    Msg->Id = Id;
    Msg->Size = (uint32)Size;
    return CFE_SUCCESS;
}
CFE_Status_t CFE_MSG_GetMsgId(const CFE_MSG_Message_t *Msg, CFE_SB_MsgId_t *Id)
{
    *Id = Msg->Id;
    return CFE_SUCCESS;
}
CFE_Status_t CFE_MSG_GetSize(const CFE_MSG_Message_t *Msg, CFE_MSG_Size_t *Size)
{
    *Size = Msg->Size;
    return CFE_SUCCESS;
}
CFE_SB_MsgId_t CFE_SB_ValueToMsgId(uint32 Value)
{
    return Value;
}
uint32 CFE_SB_MsgIdToValue(CFE_SB_MsgId_t Id)
{
    return Id;
}
CFE_Status_t CFE_SB_CreatePipe(CFE_SB_PipeId_t *Pipe, uint16 Depth, const char *Name)
{
    *Pipe = Depth;
    return (Name[0] != '\0') ? CFE_SUCCESS : -1;
}
CFE_Status_t CFE_SB_Subscribe(CFE_SB_MsgId_t Id, CFE_SB_PipeId_t Pipe)
{
    (void)Id;
    subscribed += (Pipe == @APP@_PIPE_DEPTH) ? 1 : 0;
    return CFE_SUCCESS;
}
CFE_Status_t CFE_SB_ReceiveBuffer(CFE_SB_Buffer_t **Buffer, CFE_SB_PipeId_t Pipe, int32 TimeOut)
{
    (void)Pipe;
    (void)TimeOut;
    double value = 0;
    if (scanf("%d %d", &message.Input.period, &message.Input.controller) != 2) {
        return -1;
    }
    (void)CFE_MSG_Init(CFE_MSG_PTR(message.CommandHeader), @APP@_INPUT_MID, sizeof(message));
    for (int i = 0; i < @N@ + @M@; i++) {
        if (scanf("%la", &value) != 1) {
            return -1;
        }
        if (i < @N@) {
            message.Input.state[i] = (@PREFIX@_real)value;
        } else {
            message.Input.command[i - @N@] = (@PREFIX@_real)value;
        }
    }
    if (message.Input.period == -7) { /* housekeeping, and a message that is too short */
        message.CommandHeader.Msg.Id = @APP@_SEND_HK_MID;
    } else if (message.Input.period == -8) {
        message.CommandHeader.Msg.Size = 4;
    } else {
        /* a call */
    }
    *Buffer = (CFE_SB_Buffer_t *)(void *)&message;
    return CFE_SUCCESS;
}
void CFE_SB_TimeStampMsg(CFE_MSG_Message_t *Msg)
{
    (void)Msg;
}
CFE_Status_t CFE_SB_TransmitMsg(const CFE_MSG_Message_t *Msg, bool Count)
{
    (void)Count;
    if (Msg->Id == @APP@_VERDICT_MID) {
        const @APP@_VerdictMsg_t *const sent = (const @APP@_VerdictMsg_t *)(const void *)Msg;
        printf("%d %d %u", sent->Period, sent->Output.mode, sent->Output.fault);
        for (int i = 0; i < @M@; i++) {
            printf(" %a", (double)sent->Output.command[i]);
        }
        printf(" %a\n", (double)sent->Output.margin);
    } else {
        const @APP@_HkMsg_t *const sent = (const @APP@_HkMsg_t *)(const void *)Msg;
        printf("hk %u %u %d %u\n", sent->Calls, sent->Errors, sent->Mode, sent->Fault);
    }
    return CFE_SUCCESS;
}
CFE_Status_t CFE_TBL_Register(CFE_TBL_Handle_t *Handle, const char *Name, size_t Size, uint16 Options,
                              CFE_TBL_CallbackFuncPtr_t Validate)
{
    *Handle = Options;
    validate = Validate;
    const bool same = (Size == CFE_TBL_FileDef.ObjectSize) && (strstr(CFE_TBL_FileDef.TableName, Name) != NULL);
    return same ? CFE_SUCCESS : -1;
}
CFE_Status_t CFE_TBL_Load(CFE_TBL_Handle_t Handle, CFE_TBL_SrcEnum_t Source, const void *File)
{
    (void)Handle;
    (void)Source;
    const bool named = strstr((const char *)File, CFE_TBL_FileDef.TargetFile) != NULL;
    loaded = (named && (validate(&@APP@_Table) == CFE_SUCCESS)) ? 1 : 0;
    return (loaded == 1) ? CFE_SUCCESS : -1;
}
CFE_Status_t CFE_TBL_Manage(CFE_TBL_Handle_t Handle)
{
    return Handle;
}
CFE_Status_t CFE_TBL_GetAddress(void **Image, CFE_TBL_Handle_t Handle)
{
    (void)Handle;
    *Image = (loaded == 1) ? &@APP@_Table : NULL;
    return (loaded == 1) ? CFE_TBL_INFO_UPDATED : -1;
}
CFE_Status_t CFE_TBL_ReleaseAddress(CFE_TBL_Handle_t Handle)
{
    return Handle;
}

int main(void)
{
    @APP@_Main();
    printf("%d %d %d %d\n", loaded, subscribed, events, status);
    return 0;
}
