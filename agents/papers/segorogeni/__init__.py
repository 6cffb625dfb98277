"""The paper of 2019 on the AUV Segorogeni ITS: an ensemble Kalman filter in three dimensions."""
