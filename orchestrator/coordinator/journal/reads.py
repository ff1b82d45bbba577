"""The calls of the journal that change nothing."""

from orchestrator.coordinator.journal.store import (
    AlarmJournal,
    ApprovalStore,
    CommandStore,
    JournalStore,
    LearnedStore,
    PointRowStore,
    PointUploads,
    StatisticsStore,
)

READS = frozenset(
    function.__name__
    for function in (
        JournalStore.list_decisions,
        JournalStore.find_jobs,
        JournalStore.find_referenced_jobs,
        JournalStore.load_job,
        JournalStore.load_job_body,
        JournalStore.find_keyed_job,
        JournalStore.load_recording,
        JournalStore.load_report,
        JournalStore.list_named_points,
        JournalStore.require_latest_epoch,
        JournalStore.list_reservations,
        JournalStore.list_positions,
        JournalStore.load_record,
        JournalStore.list_transitions,
        JournalStore.list_unfinished,
        PointRowStore.load_points,
        AlarmJournal.load_alarms,
        AlarmJournal.load_history,
        AlarmJournal.load_notices,
        ApprovalStore.load_approval,
        CommandStore.list_commands,
        StatisticsStore.read_rows,
        LearnedStore.load_times,
        PointUploads.read_rows,
    )
)
"""Their names."""
